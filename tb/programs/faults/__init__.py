# SPDX-License-Identifier: Apache-2.0
"""Faults in the run itself: a command whose processes, disk, files and tools fail under it."""
