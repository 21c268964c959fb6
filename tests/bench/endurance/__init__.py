# SPDX-License-Identifier: Apache-2.0
"""What the twin must bear for long: starts in any order, a bad network, killed nodes."""
