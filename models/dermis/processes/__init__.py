# SPDX-License-Identifier: Apache-2.0
"""Child processes: started with a time limit, and ended with all their own children."""
