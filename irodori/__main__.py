"""Entry point of ``python -m irodori``."""

from irodori.command_line import main

raise SystemExit(main())
