"""Configuration checks across files, beyond what a schema can express.

`consistency` runs all of them; each other module has the checks of one subject.
"""
