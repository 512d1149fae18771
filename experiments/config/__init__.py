"""Reading and checking YAML input: every mistake names the file, the line, the key and the nearest valid name."""
