# SPDX-License-Identifier: Apache-2.0
"""Random scenes through the engines, held against laws of the physics; failures are kept."""
