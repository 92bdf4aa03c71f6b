"""``python -m gaussian_enhancer`` is the command line."""

from gaussian_enhancer.cli.main import main

if __name__ == "__main__":
    main()
