import os
import sys

# -m puts the current folder first; do not import modules from there
if not sys.flags.safe_path and sys.path[0] == os.getcwd():
    del sys.path[0]

from twin.cli import main

main()
