# SPDX-License-Identifier: Apache-2.0
"""Sweep of resistance: frequency and codes of the four interfaces, as models and in transistors."""
