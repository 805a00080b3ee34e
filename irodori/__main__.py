"""The command ``python -m irodori``, which is ``irodori`` where the package is installed."""

from irodori.command_line import main

raise SystemExit(main())
