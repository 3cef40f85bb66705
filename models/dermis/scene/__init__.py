# SPDX-License-Identifier: Apache-2.0
"""What a scene says: its tables, the stimulus, the sensor sheet and the design values."""
