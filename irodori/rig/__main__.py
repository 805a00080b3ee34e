"""Entry point of ``python -m irodori.rig``."""

from irodori.capture.command import main

raise SystemExit(main())
