# SPDX-License-Identifier: Apache-2.0
"""The noise of a residual: prediction error of an autoregression, spectrum, covariance that heeds it."""
