"""Turn one point cloud into a gradient map, and save the map as numbers and as a picture."""

import gpgrad_core as gg

# A dataset is a folder of clouds. Load one cloud alone with ``gg.load_cloud("cloud.ply")``.
dataset = gg.load_dataset(gg.demo_path())
submap = dataset.submap("007")
print(f"submap {submap.id}: {len(submap.points):,} points")

# The Gaussian process knows the terrain everywhere; the grid says where to look at it.
params = gg.MapParams(length_scale=0.3, noise_std=0.05, resolution=0.05)
terrain = gg.infer_gradient_map(submap, params)
rows, columns = terrain.grid.shape
print(f"map: {rows} x {columns} cells of {terrain.grid.resolution} m")

# Far from all points the map is a guess. The standard deviation says where that is.
trusted = terrain.trusted(max_std_ratio=0.3)
print(f"{trusted.mean():.0%} of the cells are trusted")
print(
    f"elevation {terrain.elevation[trusted].min():.2f} to {terrain.elevation[trusted].max():.2f} m"
)
print(f"steepest trusted slope: {terrain.gradient[trusted].max():.2f} m/m")

gg.write_map("map.npz", terrain)  # arrays, for NumPy
gg.write_map("map.png", terrain, name=submap.id)  # layers with legends, for people
print("wrote map.npz and map.png")
