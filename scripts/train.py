"""``navsim train``, for a checkout whose environment is not active: python scripts/train.py --help"""

import sys

from rl.cli import main

if __name__ == "__main__":
    sys.exit(main(["train", *sys.argv[1:]]))
