"""Reading and checking YAML input: every mistake names the file, the line, the key and the nearest valid name.

Nothing here knows what an experiment or a scene is. Begin with ``source``: data that remembers its lines, and models
that are validated against it; ``yaml_text`` parses, ``messages`` words what is wrong, ``overrides`` is ``--set``.
"""
