"""`python -m riskplan`: the same as the command `riskplan`."""

import sys

from riskplan.cli import main

if __name__ == "__main__":
    sys.exit(main())
