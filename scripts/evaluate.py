"""``navsim evaluate``, for a checkout whose environment is not active: python scripts/evaluate.py --help"""

import sys

from rl.cli import main

if __name__ == "__main__":
    sys.exit(main(["evaluate", *sys.argv[1:]]))
