"""The rig from the command line: ``python -m irodori.rig --help``."""

from irodori.capture.command import main

raise SystemExit(main())
