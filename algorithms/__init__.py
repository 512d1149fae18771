"""Shadow techniques, one file each, found by scanning this package's folders (``algorithms.plugins``)."""
