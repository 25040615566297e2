"""`python -m foten.cli`."""

from foten.cli import main

if __name__ == "__main__":
    main()
