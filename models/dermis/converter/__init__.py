# SPDX-License-Identifier: Apache-2.0
"""The charge-balance converter: the count as a formula, clock by clock, and its noise."""
