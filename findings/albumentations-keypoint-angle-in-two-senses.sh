#!/usr/bin/env bash
# albumentations 2.0.8, keypoints with an angle (format "xya"): what a quarter turn of the image makes of it.
#
# Guess: RandomRotate90 by one quarter and Rotate by 90 degrees make the same image, and the same angle; in either it turns as two
# points do that lie along it.
# Seen: the images are the same, the points as well, the angles are half a turn apart: of 30 degrees RandomRotate90 makes 300 (which is
# where the two points lie, y downwards) and Rotate 120. Rotate, SafeRotate, ShiftScaleRotate and Affine all turn angles against the image,
# and flips, Transpose and quarter turns with it: no one convention of the angle is right for both.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet albumentations==2.0.8 numpy==2.2.6 opencv-python-headless==4.12.0.88
NO_ALBUMENTATIONS_UPDATE=1 env/bin/python - <<'PYTHON'
import albumentations as A
import numpy as np

side, start = 201, 30.0
picture = np.random.default_rng(0).integers(0, 255, (side, side, 3), dtype=np.uint8)
near = np.array([100.0, 100.0])
ahead = near + 50 * np.array([np.cos(np.radians(start)), np.sin(np.radians(start))])


def turned(transform):
    keypoints = A.KeypointParams("xya", remove_invisible=False)
    done = A.Compose([transform], keypoint_params=keypoints, seed=0)(image=picture, keypoints=[(*near, start), (*ahead, start)])
    points = np.array(done["keypoints"])
    along = points[1, :2] - points[0, :2]
    return done["image"], points[0, 2] % 360, np.degrees(np.arctan2(along[1], along[0])) % 360


class Quarter(A.RandomRotate90):
    def get_params(self):
        return {"factor": 1}


answers = {
    "RandomRotate90, one quarter": turned(Quarter(p=1)),
    "Rotate by 90": turned(A.Rotate((90, 90), p=1)),
    "Affine by 90": turned(A.Affine(rotate=(90, 90), p=1)),
    "SafeRotate by 90": turned(A.SafeRotate((90, 90), p=1)),
    "HorizontalFlip": turned(A.HorizontalFlip(p=1)),
    "VerticalFlip": turned(A.VerticalFlip(p=1)),
    "Transpose": turned(A.Transpose(p=1)),
}
for name, (_, angle, right) in answers.items():
    print(f"{name}: angle {angle:.1f}, two points along it lie at {right:.1f}")
quarter, rotate = answers["RandomRotate90, one quarter"], answers["Rotate by 90"]
print("same image:", np.array_equal(quarter[0], rotate[0]))
apart = {name: abs((angle - right + 180) % 360 - 180) for name, (_, angle, right) in answers.items()}
assert np.array_equal(quarter[0], rotate[0]) and abs(abs(quarter[1] - rotate[1]) - 180) < 0.1
assert all((gap > 179) == ("by 90" in name) and (gap > 179 or gap < 0.1) for name, gap in apart.items()), apart
PYTHON
