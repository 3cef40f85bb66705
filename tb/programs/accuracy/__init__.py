# SPDX-License-Identifier: Apache-2.0
"""What accuracy costs in simulation time: engines and settings on the same work, drawn as error against time."""
