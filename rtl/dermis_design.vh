// SPDX-License-Identifier: Apache-2.0
// Defaults of the top-level parameters. Generated from models/design.toml; change it there and run: dermis generate
`ifndef DERMIS_DESIGN_VH
`define DERMIS_DESIGN_VH
`define DERMIS_ROWS          16
`define DERMIS_COLS          16
`define DERMIS_CODE_BITS     8
`define DERMIS_GATE_CLOCKS   510
`define DERMIS_SETTLE_CLOCKS 115
`define DERMIS_BREAK_CLOCKS  1
`define DERMIS_SLOT_CLOCKS   625
`define DERMIS_T_CLK_PS      200000
`endif
