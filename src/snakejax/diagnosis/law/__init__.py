"""The law of a force that no known effect explains: its formula, found by a sparse search and fitted to whole runs."""
