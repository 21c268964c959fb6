# SPDX-License-Identifier: Apache-2.0
"""`python -m waferbot_twin` is the waferbot command."""

import sys

from waferbot_twin.cli import main

if __name__ == '__main__':
    sys.exit(main())
