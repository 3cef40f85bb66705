# SPDX-License-Identifier: Apache-2.0
"""Hostile input: fuzzers guided by coverage for everything that comes from outside, and what they have found."""
