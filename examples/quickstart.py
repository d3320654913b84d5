"""Find and track two drones in a simulated street."""

import lidar_core as lc

detector = lc.flying.FlyingObjectDetector(lc.flying.FlyingConfig(), threads=2)
for made in lc.sim.simulate(lc.sim.scenes.demo(seed=0), seed=0, scans=15):
    # `made` holds a scan, the pose of the sensor and the ground truth.
    frame = detector.process(made)
    # `number` is the ID of a track.
    for number, position in zip(frame.tracks.id, frame.tracks.position, strict=True):
        print(f"{frame.stamp_ns * 1e-9:.1f} s: track {number} at {position.round(2)} m")
