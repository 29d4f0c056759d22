"""``python -m cellsys``: the command line."""

from cellsys.cli import main

if __name__ == "__main__":
    main()
