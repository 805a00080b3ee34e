"""The command ``python -m irodori.rig``, implemented in `irodori.capture`."""
