# SPDX-License-Identifier: Apache-2.0
"""Hostile input for everything that reads from outside, drawn and shrunk by Hypothesis."""
