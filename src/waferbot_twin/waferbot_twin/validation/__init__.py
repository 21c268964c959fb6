# SPDX-License-Identifier: Apache-2.0
"""What an extended model gains in logs that were not used for the fit."""
