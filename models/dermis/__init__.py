# SPDX-License-Identifier: Apache-2.0
"""Mixed-signal readout of piezoresistive artificial skin: models, engines and the co-simulation."""

__version__ = "0.1.0"
