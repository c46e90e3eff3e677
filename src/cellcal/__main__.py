"""``python -m cellcal`` is the command ``cellcal``."""

from cellcal.service.__main__ import main

if __name__ == "__main__":
    main()
