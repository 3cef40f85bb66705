# SPDX-License-Identifier: Apache-2.0
"""A behavioural model and simulator of a force-sensing skin readout."""
