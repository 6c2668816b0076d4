"""python -m tunefree_hil"""

from tunefree_hil.cli import main

if __name__ == "__main__":
    main()
