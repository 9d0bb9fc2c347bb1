"""``python -m trocar``: says where the server's program is; with arguments, runs it with them."""

import os
import sys

from trocar import __version__
from trocar.errors import LaunchError
from trocar.server import binary


def main() -> None:
    """Finds the program and becomes it, or says where it is."""
    try:
        program = binary()
    except LaunchError as error:
        sys.exit(f"trocar {__version__}: {error}")
    if len(sys.argv) > 1:
        os.execv(program, [program, *sys.argv[1:]])
    print(program)


if __name__ == "__main__":
    main()
