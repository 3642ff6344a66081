"""``python -m torch_orennayar`` is the command ``orennayar``."""

from .cli import main

main()
