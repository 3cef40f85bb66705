# SPDX-License-Identifier: Apache-2.0
"""Timing of the sky130_fd_sc_hd cells in use, as Liberty files."""
