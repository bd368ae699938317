"""Other packages at the same works; each module is imported when its peer is asked for."""
