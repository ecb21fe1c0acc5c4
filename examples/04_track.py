"""One car in several images: a pose for each, and one shape for all of them.

The images are simulated with the mistakes of a real network. What is solved (factors of image t on the left):

    reprojection_i, box ------ X(0,0) ---- ground
         |
    reprojection_i, box ------ X(0,1) ---- ground
         |                      ...
        L(0) ----- N(0, I), symmetry, faces, size
     (lambda)
"""

import sys

import numpy as np

import fgrecon
from fgrecon.simulation import KITTI_CAMERA, Vehicle, simulate_track
from fgrecon.viz import TrackInputs, Truth, track_recording_of


def main(recording: str | None) -> None:
    rng = np.random.default_rng(25)
    car = Vehicle.sample(fgrecon.load_prior("car14"), rng)
    frames = simulate_track(car, 12, rng)
    seen, truths = [observation for observation, _ in frames], [truth for _, truth in frames]

    track = fgrecon.reconstruct_track(seen, KITTI_CAMERA, ground=1.65)

    alone = [
        fgrecon.reconstruct(s.keypoints, KITTI_CAMERA, confidence=s.confidence, box=s.box, ground=1.65) for s in seen
    ]
    errors = [np.linalg.norm(result.wireframe - car.keypoints, axis=1).mean() for result in alone]
    together = np.linalg.norm(track.frames[0].wireframe - car.keypoints, axis=1).mean()
    print(f"{track.status}: {track.message}")
    print(f"length, width, height {track.box_size.round(2)} m")
    print(f"shape off by {100 * together:.1f} cm, image by image {100 * np.mean(errors):.1f} cm on average")
    for t, (frame, truth) in enumerate(zip(track.frames, truths, strict=True)):
        x, _, z = frame.location
        off = np.linalg.norm(frame.location - truth.camera_T_object[:3, 3])
        print(
            f"image {t:2d}: yaw {np.degrees(frame.rotation_y):.1f} degrees at ({x:.2f}, {z:.2f}) m, off by {off:.2f} m"
        )

    if recording is not None:  # watch it: fgrecon replay FILE.rrd
        known = [Truth(truth.camera_T_object, keypoints=car.keypoints) for truth in truths]
        track_recording_of(track, TrackInputs(seen, [KITTI_CAMERA] * len(seen), truths=known)).write(recording)


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else None)
