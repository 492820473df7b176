"""`python -m wheelsight`: the command line where its script is not on the path."""

from wheelsight.app.cli import main

if __name__ == "__main__":
    main()
