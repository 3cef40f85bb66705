# SPDX-License-Identifier: Apache-2.0
"""Contents of a scene: its tables, the stimulus, the sensor sheet and the design values."""
