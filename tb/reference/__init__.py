# SPDX-License-Identifier: Apache-2.0
"""Slow, obvious references that the fast code is tested against."""
