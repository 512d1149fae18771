"""``python -m wkernels``: the command line, by the name that people know it by."""

import importlib

if __name__ == "__main__":
    # By name: nothing here depends on the packages above, and this file only passes the word on.
    importlib.import_module("experiments.cli").main()
