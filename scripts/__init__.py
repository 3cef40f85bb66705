# SPDX-License-Identifier: Apache-2.0
"""Programs that the make targets of the chip run."""
