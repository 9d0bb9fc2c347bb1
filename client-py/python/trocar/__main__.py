"""``python -m trocar``: says where the program is; with arguments, runs it in this environment.

What the program itself starts in Python runs in this Python, unless ``$TROCAR_PYTHON`` names
another.
"""

import os
import sys

from trocar import __version__, _trocar
from trocar.errors import LaunchError
from trocar.server import binary


def main() -> None:
    """Finds the program and becomes it, or says where it is."""
    try:
        program = binary()
    except LaunchError as error:
        sys.exit(f"trocar {__version__}: {error}")
    if len(sys.argv) == 1:
        print(program)
        return
    python = os.environ.get("TROCAR_PYTHON") or sys.executable
    variables = {**os.environ, "TROCAR_PYTHON": python}
    try:
        os.execve(program, [program, *sys.argv[1:]], variables)
    except OSError as error:
        advice = f"${_trocar.BINARY} may name another program"
        sys.exit(f"trocar {__version__}: {program}: {error.strerror}; {advice}")


if __name__ == "__main__":
    main()
