"""Run the command line by ``python -m gaussian_enhancer``."""

from gaussian_enhancer.cli.main import main

if __name__ == "__main__":
    main()
