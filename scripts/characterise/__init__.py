# SPDX-License-Identifier: Apache-2.0
"""The blocks of spice/sky130 over corners, temperatures, supplies and mismatch, against models/spec.toml."""
