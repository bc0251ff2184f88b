"""The viewer: sessions in a browser; one folder for each feature that a user sees."""
