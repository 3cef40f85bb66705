# SPDX-License-Identifier: Apache-2.0
"""The real circuit for the engines rtl and cosim: netlist, ngspice, Verilog builds and the
lock-step bridge.
"""
