"""Kind ``walkthrough``: every listed technique on the frames of a path, compared with a reference."""
