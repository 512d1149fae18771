"""Kind ``convergence``: error over frames of a still camera or over light samples."""
