# SPDX-License-Identifier: Apache-2.0
"""Speed and accuracy of the engines, and of other simulators on the same circuit."""
