"""Ways of drawing keypoints from a gradient map and describing them, one a file."""
