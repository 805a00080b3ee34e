"""What no schema sees of definitions: that they agree with each other, and that the files they name are there.

`definitions` goes through all of them; each other module holds what concerns one kind of thing.
"""
