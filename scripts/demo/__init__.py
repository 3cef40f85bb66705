# SPDX-License-Identifier: Apache-2.0
"""The demo: one web page with the chip's Verilog inside."""
