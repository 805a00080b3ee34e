"""The command ``python -m irodori.rig``; the code stands in `irodori.capture`."""
