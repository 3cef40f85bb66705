# SPDX-License-Identifier: Apache-2.0
"""Error against simulation time: engines and settings on the same work."""
