#!/usr/bin/env bash
# motrics 0.3.0 beside trackeval 1.3.0: "bit-exact parity with TrackEval on CLEAR, Identity, and HOTA", says the page of the package.
#
# Guess: one MOTA, one number of identity switches, whatever the similarities are.
# Seen: HOTA and IDF1 are, CLEAR is so only while nobody comes close. TrackEval keeps the pair of the frame before if it is still above the limit,
# motrics gives it up for two new ones (a match and a switch more); after a frame without a match TrackEval starts anew, motrics
# returns to the track from before the gap (a switch less). Of 20 crowds of eight boxes that cross each other half have another MOTA.
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet motrics==0.3.0 trackeval==1.3.0 numpy==2.3.5
env/bin/python - <<'PYTHON'
import motrics
import numpy as np
from trackeval.metrics import CLEAR, HOTA, Identity


def both(labels, tracks, similarities):
    """(Matches, switches, MOTA) of TrackEval and of motrics, and how far apart their HOTA and IDF1 are."""
    count = 1 + max(max(map(max, labels)), max(map(max, tracks)))
    data = {"num_timesteps": len(labels), "gt_ids": [np.array(ids) for ids in labels], "tracker_ids": [np.array(ids) for ids in tracks]}
    data |= {"similarity_scores": [np.array(each, float) for each in similarities], "num_gt_ids": count, "num_tracker_ids": count}
    data |= {"num_gt_dets": sum(map(len, labels)), "num_tracker_dets": sum(map(len, tracks))}
    clear, hota = CLEAR({"PRINT_CONFIG": False}).eval_sequence(data), HOTA().eval_sequence(data)["HOTA"].mean()
    identity = Identity({"PRINT_CONFIG": False}).eval_sequence(data)["IDF1"]
    other = motrics.compute_clear_from_similarity(labels, tracks, similarities)
    apart = abs(hota - motrics.compute_hota_from_similarity(labels, tracks, similarities).hota)
    apart = max(apart, abs(identity - motrics.compute_identity_from_similarity(labels, tracks, similarities).idf1))
    reference = (int(clear["CLR_TP"]), int(clear["IDSW"]), round(float(clear["MOTA"]), 4))
    return reference, (other.num_matches, other.num_switches, round(other.mota, 4)), apart


close = both([[0], [0, 1]], [[0], [0, 1]], [[[0.9]], [[0.55, 0.9], [0.9, 0.0]]])
gap = both([[0], [0], [0]], [[0], [0], [0, 1]], [[[0.9]], [[0.2]], [[0.6, 0.9]]])
for name, (reference, told, _) in {"two come close": close, "a frame without a match": gap}.items():
    print(f"{name}: matches, switches, MOTA of TrackEval {reference}, of motrics {told}")
assert close[:2] == ((2, 0, 0.3333), (3, 1, 0.6667)) and gap[:2] == ((2, 1, -0.3333), (2, 0, 0.0))

different, farthest = 0, 0.0
for seed in range(20):
    rng = np.random.default_rng(seed)
    places, speeds, names = rng.uniform(0, 60, (8, 2)), rng.normal(0, 1.5, (8, 2)), np.arange(8)
    labels, tracks, similarities = [], [], []
    for _ in range(60):
        places = places + speeds
        if rng.random() < 0.15:  # the tracker takes one for another
            pair = rng.choice(8, 2, replace=False)
            names[pair] = names[pair[::-1]]
        seen, found = np.flatnonzero(rng.random(8) < 0.95), np.flatnonzero(rng.random(8) < 0.9)
        gaps = abs(places[seen][:, None] - (places[found] + rng.normal(0, 3, (len(found), 2)))[None])
        shared = np.clip(20 - gaps, 0, None).prod(axis=2)  # boxes of 20 x 20
        labels.append(seen.tolist())
        tracks.append(names[found].tolist())
        similarities.append((shared / (800 - shared)).tolist())
    reference, told, apart = both(labels, tracks, similarities)
    different, farthest = different + (reference != told), max(farthest, apart)
print(f"20 crowds: {different} with another MOTA; HOTA and IDF1 at most {farthest:.1e} apart")
assert 6 <= different <= 14 and farthest < 1e-9
PYTHON
