# SPDX-License-Identifier: Apache-2.0
"""Where a fit may begin: candidates, grids, spectral lines, modes, orders."""
