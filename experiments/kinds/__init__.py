"""The kinds of experiment, a folder each: its schema, how it runs, its report."""
