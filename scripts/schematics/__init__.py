# SPDX-License-Identifier: Apache-2.0
"""Schematic sheets of the circuits in transistors: drawn, and compared with the netlists."""
