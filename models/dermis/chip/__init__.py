# SPDX-License-Identifier: Apache-2.0
"""The real circuit of engines rtl and cosim: netlist, ngspice, Verilog and their lock-step."""
