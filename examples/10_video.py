"""A video in, a tracked car out: where it is in each frame, and how fast it goes.

The video is rendered; give the path of yours and its camera in its place.

     frames ---- detector, networks ---- boxes, keypoints ---- association ---- ids
                                                                                 |
                     (stored, so that a run that was killed goes on)             |
                                                                                 |
     L(v) ---- X(v,t) ---- motion ---- X(v,t+1) ---- keypoints, box, ground -----+
   (lambda)    (pose)      V(v,t)
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import fgrecon
from fgrecon.perception import KeypointCascade, NanodetVehicleDetector
from fgrecon.simulation import sample_drive
from fgrecon.video import Follower, FrameDetector, GatedAssociation, open_frames, run_video, write_video


def main() -> None:
    prior, ground = fgrecon.load_prior("car14"), fgrecon.Ground.level(1.65)
    drive = sample_drive(prior, frames=6)
    camera, truths = drive[0].camera, [frame.cars[0].truth.camera_T_object[:3, 3] for frame in drive]
    with TemporaryDirectory() as name:
        video = Path(name) / "drive.mp4"
        with write_video(video, rate=10) as add:
            for frame in drive:
                add(frame.image, None)

        networks = {"vehicle_detector": NanodetVehicleDetector(), "keypoint_detector": KeypointCascade()}
        detector = FrameDetector(prior.category, **networks)
        follower = Follower(fgrecon.Tracker(prior=prior), GatedAssociation(), camera, ground=ground)
        run = run_video(open_frames(video), detector, follower, Path(name) / "tracked", settings={"video": video.name})

    print(f"{len(run.frames)} frames, cars: {run.tracks}")
    for frame, truth in zip(run.frames, truths, strict=True):
        for identity, estimate in frame.estimates.items():
            place = estimate.reconstruction.location
            off, speed = np.linalg.norm(place - truth), estimate.speed or 0.0
            print(f"{frame.time:.1f} s: car {identity} at {place.round(2)} m, off by {off:.2f} m, {speed:.1f} m/s")


if __name__ == "__main__":
    main()
