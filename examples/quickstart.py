"""Find and track two drones in a simulated street."""

import lidar_core as lc

detector = lc.flying.FlyingObjectDetector(lc.flying.FlyingConfig(), threads=2)
for made in lc.sim.simulate(lc.sim.scenes.demo(seed=0), seed=0, scans=15):
    scan = made.scan
    frame = detector.process(
        scan.points,
        made.poses,
        scan.stamp_ns,
        no_return=scan.no_return,
        directions=scan.directions,
        point_time_ns=scan.point_time_ns,
        pose_stamps_ns=made.pose_stamps_ns,
    )
    for number, position in zip(frame.tracks.id, frame.tracks.position, strict=True):
        print(f"{scan.stamp_ns * 1e-9:.1f} s: track {number} at {position.round(2)} m")
