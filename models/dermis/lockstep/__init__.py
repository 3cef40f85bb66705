# SPDX-License-Identifier: Apache-2.0
"""Any Verilog with any SPICE in lock-step: digital edges at their exact times, inside a cocotb test.

The page docs/lockstep.md shows three examples and lists the restrictions. This room knows nothing
of this project's chip, which is built on it (dermis.chip.bridge).
"""

from dermis.lockstep.cosim import Compare, Cosim, Drive, Reset

__all__ = ["Compare", "Cosim", "Drive", "Reset"]
