# SPDX-License-Identifier: Apache-2.0
"""Which experiment tells causes apart that the logs at hand cannot separate."""
