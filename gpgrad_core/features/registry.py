"""All detectors of keypoints: flags, files, the viewer, tests and the guide follow this list."""

from gpgrad_core.features.detection import Detector
from gpgrad_core.features.opencv import opencv_detector
from gpgrad_core.features.slope_field import detect_slope_field
from gpgrad_core.features.surf import detect_surf

DETECTORS: dict[str, Detector] = {
    detector.name: detector
    for detector in (
        # AKAZE scales its contrast to the image, so gentle and steep ground give the same.
        Detector("akaze", opencv_detector("AKAZE_create", threshold=1e-6), "blobs", 95),
        Detector("kaze", opencv_detector("KAZE_create", threshold=1e-6), "blobs", 530),
        Detector(
            "sift",
            opencv_detector(
                "SIFT_create", as_bytes=True, nfeatures=0, contrastThreshold=0.0, edgeThreshold=10.0
            ),
            "blobs",
            235,
        ),
        # ORB needs a limit, and leaves a margin of 31 pixels on every side.
        Detector(
            "orb",
            opencv_detector(
                "ORB_create", as_bytes=True, least_side=64, nfeatures=5000, fastThreshold=1
            ),
            "corners",
            20,
        ),
        Detector("surf", lambda made, _: detect_surf(made.gradient), "blobs", 150),
        Detector("slope", lambda made, _: detect_slope_field(made), "landforms", 40),
    )
}
