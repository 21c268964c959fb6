# SPDX-License-Identifier: Apache-2.0
"""The twin as a whole: run, record, replay, compare, plot."""

import os

from waferbot_twin.workers import end_with_parent

# A sum that BLAS divides among threads is rounded differently with another number of cores. Our
# matrices are small: one thread is faster, too. Must be said before numpy is imported.
os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

end_with_parent()
