"""What the operating system gives: locks of files, folders of a user alone. It knows nothing of the rest."""
