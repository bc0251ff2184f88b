"""What a user sees: each feature is a folder with a panel, a scene, and the tab that joins them."""
