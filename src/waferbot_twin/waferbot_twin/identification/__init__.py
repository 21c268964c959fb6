# SPDX-License-Identifier: Apache-2.0
"""Named parameters of a model from measured runs, with how sure they are and what stays open."""
