"""Effects: one file each, an explicit list, nothing built unless a scene names it."""
