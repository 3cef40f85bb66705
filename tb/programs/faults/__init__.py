# SPDX-License-Identifier: Apache-2.0
"""Faults in the run itself: what a command does when its processes, disk, files and tools fail
under it.
"""
