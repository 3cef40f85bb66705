# SPDX-License-Identifier: Apache-2.0
"""Child processes: started with a limit, and ended with everything they started."""
