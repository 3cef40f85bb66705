# SPDX-License-Identifier: Apache-2.0
"""The resistive network between row drivers and column inputs, and how it settles."""
