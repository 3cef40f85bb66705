// SPDX-License-Identifier: Apache-2.0
// The synchronizer as it is, with random metastability: stands for module dermis_tech_sync where a
// test asks for it.
`define DERMIS_SYNC_RANDOM
`include "dermis_tech_sync.v"
