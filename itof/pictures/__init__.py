"""Pictures, films and point clouds of predictions. May import the other modules of `itof`."""
