"""The whole detector in plain Python: clusters, classes, map, removal, tracks, one after the other.

Written from sec. III of Vrba et al., the text of `FlyingConfig` and the documentation of
`FlyingObjectDetector`; made of the oracles of its parts. One LiDAR, one pose per scan or a stream
of poses. Not here: what stands still during the burn-in and how it leaves, the check for jumps of
the pose, masks, teammates, beam tables, movers that no track follows.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from reference import center, expected, separate
from reference.classify import classify, clearance, diagonal, flying_or_unknown
from reference.cluster import cluster_points
from reference.tracker import Tracker
from reference.voxel_map import BACKGROUND, FLYING, UNKNOWN, VoxelMap

RAYS_TO_CUT = 2  # so many that end in front of a target may hide a part of it
LOOKS_PAST, LONGEST_PAUSE = 0.1, 1.0  # [m] across the line of sight, [s]
RAYS_TO_SEE = 3  # a target that fewer rays meet may give no return
POINTS_HALF_SURE = 3.0
MOVING, FLYING_KIND, GROUND_KIND = 4, 1, 2
MAYBE = 7.81  # 95 % of chi-square of 3 degrees of freedom
OWN_RADIUS, ALONE_RADIUS = 0.75, 2.0  # what belongs to a few points, and what may not be there


@dataclass
class Frame:
    point_class: np.ndarray
    position: np.ndarray
    covariance: np.ndarray
    radius: np.ndarray
    extent: np.ndarray
    n_points: np.ndarray
    confidence: np.ndarray
    tracks: list = field(default_factory=list)
    gate: str = "open"


class RememberingMap(VoxelMap):
    """The map, with its occupied voxels looked up once after every change."""

    known = None

    def pull(self, voxel, target, weight):
        self.known = None
        super().pull(voxel, target, weight)

    def occupied(self):
        if self.known is None:
            self.known = super().occupied()
        return self.known


class SeeingTracker(Tracker):
    """A tracker that knows which places a scan could see."""

    def update(self, tracks, stamp, points, occupied, delays=None):
        due = {id(track): track.aged for track in tracks if track.stamp < stamp}
        corrected = super().update(tracks, stamp, points, occupied, delays)
        for track in tracks:
            unseen = id(track) in due and track.seen != stamp
            if (
                unseen
                and self.view is not None
                and self.c.ageing == "visible"
                and self.view(track.r, self.reach(track)) < RAYS_TO_SEE
            ):
                track.aged = due[id(track)]
        return corrected

    def reported(self, stamp):
        newest = self.buffer[-1][0]
        coast = self.c.report_coast if self.c.ageing == "visible" else np.inf
        told = [
            (track, *self.at(track, stamp))
            for track in self.tracks
            if track.confirmed and (newest - track.seen) * 1e-9 <= coast
        ]
        flying = [(track.seen, x) for track, x, _ in told if track.kind == FLYING_KIND]
        for track, x, P in told:
            # one target of which two tracks were seen, and one is not seen any more
            away = [other[:3] - x[:3] for seen, other in flying if seen > track.seen]
            is_double = any(one @ np.linalg.solve(P[:3, :3], one) <= MAYBE for one in away)
            if not (
                is_double and track.kind == FLYING_KIND and self.c.report_existence is not None
            ):
                yield track.id, x, P, track.n_detections, track.kinds


class Detector:
    def __init__(self, config) -> None:
        self.c = config
        self.origin = None
        self.tracker = SeeingTracker(config.tracker)
        self.scans = 0
        self.has_background = False
        self.last = None  # stamp and place of the sensor

    def process(
        self, points, poses, stamp, no_return=None, directions=None, times=None, pose_stamps=None
    ) -> Frame:
        poses = np.reshape(poses, (-1, 4, 4))
        if self.origin is None:
            size = self.c.voxel_map.voxel_size
            self.origin = np.round(poses[0, :3, 3] / size) * size
            reach = self.c.voxel_map.max_range + self.c.range_margin
            self.map = RememberingMap(self.c.voxel_map.model_copy(update={"max_range": reach}))
        turns, places = self.motion(poses, pose_stamps, times, stamp, len(points))
        origin = self.middle(poses, pose_stamps, times, stamp, points, no_return)
        cloud = self.cloud(points, no_return, turns, places)
        rays = np.full((len(points), 3), np.nan, np.float32)
        if no_return is not None:
            rays[no_return] = np.einsum("nij,nj->ni", turns, directions.astype(float))[no_return]
        delays = np.zeros(len(points), np.float32)
        if times is not None:
            delays = ((times - stamp) * 1e-9).astype(np.float32)

        self.uncovered = []  # whether each detection of the scan ends at an edge
        self.moved, last = np.zeros(3), self.last
        if last is not None and (stamp - last[0]) * 1e-9 <= LONGEST_PAUSE:
            self.moved = origin - last[1]
        self.last = stamp, origin
        gate = self.gate()
        self.see(cloud, places, rays, no_return)
        labels = cluster_points(cloud, **self.c.cluster.model_dump(include=CLUSTERING))
        verdicts = self.verdicts(cloud, labels, origin)
        self.expected = claimed = self.claim(cloud, labels, verdicts, origin, delays, stamp)
        point_class = np.array([verdicts[label] if label >= 0 else UNKNOWN for label in labels])
        point_class[~np.isfinite(cloud).all(axis=1)] = 0
        found = self.detections(cloud, labels, verdicts, origin, delays, claimed)
        boxes = expected.Boxes(cloud, labels, claimed)
        beside = self.c.tracker.cluster_distance
        followed = boxes.without_structure(cloud, point_class, beside) if claimed else cloud

        self.map.integrate(cloud, point_class, places, rays, no_return)
        self.remove_separate()
        self.scans += 1
        self.tracker.boxes = boxes
        self.track(cloud, followed, labels, verdicts, places, origin, delays, found, stamp)
        more = self.followed(cloud, labels, verdicts, origin)
        found += self.detections(cloud, labels, more, origin, delays, np.flatnonzero(more))
        point_class[np.isin(labels, np.flatnonzero(np.array(more) == FLYING))] = FLYING
        if self.c.tracker.report_existence is not None:
            is_near = np.linalg.norm(cloud - origin, axis=1) <= (
                self.c.classify.max_distance or np.inf
            )
            self.tracker.look(stamp, cloud[(point_class == UNKNOWN) & is_near].astype(float))
        point_class[np.isin(labels, self.on_ground(cloud, labels))] = MOVING
        return self.frame(point_class, found, stamp, gate)

    def motion(self, poses, pose_stamps, times, stamp, rows):
        """Rotation and place of every ray in the frame of the map."""
        shifted = poses[:, :3, 3] - self.origin
        if len(poses) == 1:
            return np.repeat(poses[:, :3, :3], rows, 0), np.repeat(shifted, rows, 0)
        at = np.full(rows, stamp) if times is None else times
        at = np.clip(at, pose_stamps[0], pose_stamps[-1])
        turns = Slerp(pose_stamps, Rotation.from_matrix(poses[:, :3, :3]))(at).as_matrix()
        places = np.stack([np.interp(at, pose_stamps, axis) for axis in shifted.T], axis=1)
        return turns, places

    def middle(self, poses, pose_stamps, times, stamp, points, no_return):
        """Place of the sensor half way between the first and the last ray that tells anything."""
        at = stamp
        if times is not None and len(poses) > 1:
            known = times[np.isfinite(points).all(axis=1) | (no_return is not None and no_return)]
            at = (known.min() + known.max()) // 2
        return self.motion(poses, pose_stamps, None, at, 1)[1][0]

    def cloud(self, points, no_return, turns, places):
        points = points.astype(float)
        near = np.linalg.norm(points, axis=1) < self.c.sensor.min_range
        moved = np.einsum("nij,nj->ni", turns, points) + places
        moved[near | ~np.isfinite(points).all(axis=1)] = np.nan
        if no_return is not None:
            moved[no_return] = np.nan
        return moved.astype(np.float32)

    def gate(self) -> str:
        if self.scans < self.c.seed.burn_in_scans:
            return "burn-in"
        return "open" if self.has_background else "no background"

    def verdicts(self, cloud, labels, origin):
        limits = [self.c.classify.background_extent]
        if self.scans < self.c.seed.burn_in_scans:
            limits.append(self.c.seed.burn_in_extent)
        limit = min((limit for limit in limits if limit is not None), default=None)
        rules = self.c.classify.model_copy(update={"background_extent": limit})
        verdicts = classify(self.map, cloud, labels, origin, rules)
        ground = self.c.seed.ground_height
        for label in range(len(verdicts)):
            low = cloud[labels == label, 2].astype(float).min() + self.origin[2]
            if ground is not None and low < ground:
                verdicts[label] = BACKGROUND
            elif verdicts[label] == FLYING and not self.has_background:
                verdicts[label] = UNKNOWN
        return verdicts

    def see(self, cloud, places, rays, no_return) -> None:
        """Keep the rays of the scan: origins, directions, lengths."""
        spans = cloud.astype(float) - places
        self.lengths = np.linalg.norm(spans, axis=1)
        if no_return is not None:
            spans[no_return], self.lengths[no_return] = rays[no_return], np.inf
        self.known = np.isfinite(spans).all(axis=1)
        self.spans = spans
        self.origin_of = dict(zip(map(tuple, cloud.astype(float)), places, strict=True))
        self.places = places

    def center_of(self, own):
        """The centre behind points of the scan, its covariance and radius, whether it is cut."""
        origins = np.array([self.origin_of[tuple(point)] for point in own])
        middle, reach = center.region(own)
        near = center.Rays(self.places[self.known], self.spans[self.known])
        along = near.along(middle)
        lengths, margin = self.lengths[self.known], reach + center.MARGIN
        past = (along > 0) & (lengths > along + margin)
        beside = (along > 0) & (near.distance(middle) <= margin)
        hides = beside & (lengths < along - margin)
        is_cut = np.count_nonzero(hides) >= RAYS_TO_CUT
        sides = near.those(past & beside), near.those(hides)
        self.is_at_edge = center.ends_at_edge(own, origins, *sides)
        found = center.target_center(own, origins, near.those(past), self.c.range_std)
        self.outline = center.target_outline(own, origins, near.those(past), near.those(hides))
        return *found, is_cut

    def claim(self, cloud, labels, verdicts, origin, delays, stamp):
        """Make flying what tracks predict near structure; the numbers of these clusters."""
        rules = self.c.classify
        if not rules.follow_tracks or rules.map_state == "after_update":
            return []
        near = [*expected.targets(self.tracker, self.map, rules.close_distance, stamp)]
        delayed = delays.astype(float)
        found = expected.claimed(near, self.map, cloud, labels, verdicts, origin, delayed, rules)
        for label in found:
            verdicts[label] = FLYING
        return found

    def detections(self, cloud, labels, verdicts, origin, delays, only_tracked=()):
        """Those of the flying clusters; only a track tells of those `only_tracked`."""
        found = []
        for label in np.flatnonzero(np.array(verdicts) == FLYING):
            own = cloud[labels == label].astype(float)
            if self.c.position == "paper":
                place = own.mean(axis=0)
                sight = (place - origin) / np.linalg.norm(place - origin)
                covariance = (own - place).T @ (own - place) / len(own) ** 2
                covariance += (diagonal(own) / 4) ** 2 * np.outer(sight, sight)
                covariance += self.c.range_std**2 * np.eye(3)
                radius = least = diagonal(own) / 2
                self.outline, self.is_at_edge = (np.nan, np.zeros((2, 4)), None), False
            else:
                place, covariance, radius, least, _ = self.center_of(own)
            sight = own.mean(axis=0) - origin
            ahead = self.moved @ sight / np.linalg.norm(sight)
            looks_past = self.moved @ self.moved - ahead**2 > LOOKS_PAST**2
            is_uncovered = self.is_at_edge and looks_past
            self.uncovered.append(is_uncovered)
            sure = 1 - 2 ** (-len(own) / POINTS_HALF_SURE)
            place_of_shadow = origin if self.c.classify.shadow == "own" else None
            clear = clearance(self.map, own, seen_from=place_of_shadow)
            found.append(
                {
                    "position": place,
                    "covariance": covariance,
                    "radius": radius,
                    "extent": np.ptp(own, axis=0),
                    "n_points": len(own),
                    "confidence": clear * sure * (label not in only_tracked),
                    "delay": delays[labels == label].astype(float).mean(),
                    "shape": (len(own), radius, least, *self.outline, False, is_uncovered),
                }
            )
        return found

    def remove_separate(self) -> None:
        """Sec. III-D: at once, or as soon as there is something to be separate from."""
        options = self.c.separate
        reach = options.max_gap / self.map.config.voxel_size
        found = separate.groups(self.map.occupied(), reach)
        self.has_background = any(
            separate.has_enough(self.map, group, options.min_confident) for group in found
        )
        if self.has_background or not options.waits_for_background:
            separate.remove_groups(self.map, found, options.min_confident)

    def track(
        self, cloud, followed, labels, verdicts, places, origin, delays, found, stamp
    ) -> None:
        occupied = (np.array(self.map.occupied()).reshape(-1, 3) + 0.5) * self.map.config.voxel_size
        lengths = self.lengths
        directions = self.spans / np.linalg.norm(self.spans, axis=1, keepdims=True)

        def view(position, radius):
            radius = min(radius, 0.325)  # of the smallest target
            arm = position - places
            along = np.einsum("ij,ij->i", arm, directions)
            aside = np.einsum("ij,ij->i", arm, arm) - along**2
            passes = (along > 0) & (aside <= radius**2) & (lengths >= along - radius)
            return passes.sum()

        self.tracker.view = view

        def center_of(own):
            place, spread, *_, is_cut = self.center_of(own)
            return place, spread, is_cut

        self.tracker.center = center_of
        self.tracker.new_point_cloud(followed, occupied, stamp, delays.astype(float))
        self.tracker.view = self.tracker.center = self.tracker.boxes = None
        self.hint(cloud, labels, verdicts, origin)
        names = ("position", "covariance", "delay", "confidence", "shape", "extent")
        columns = ([one[name] for one in found] for name in names)
        position, *others = columns
        self.tracker.new_detections(position, occupied, stamp, *others)

    def hint(self, cloud, labels, verdicts, origin) -> None:
        """What too few points tell: unconfirmed tracks follow something alone in free space."""
        rules, newest = self.c.classify, self.tracker.buffer[-1][0]
        known = cloud[np.isfinite(cloud).all(axis=1)].astype(float)
        for track in self.tracker.tracks:
            if track.confirmed or track.seen != newest or track.points is None:
                continue
            rows = np.flatnonzero((cloud.astype(float) == track.points[0]).all(axis=1))
            label = labels[rows[0]]
            own = cloud[labels == label].astype(float)
            if label < 0 or verdicts[label] != UNKNOWN or len(own) >= rules.min_points:
                continue
            gaps = np.linalg.norm(known - own.mean(axis=0), axis=1)
            is_alone = not ((gaps > OWN_RADIUS) & (gaps <= ALONE_RADIUS)).any()
            any_number = rules.model_copy(update={"min_points": 1})
            found = flying_or_unknown(self.map, own, diagonal(own), origin, any_number)
            if is_alone and self.has_background and found == FLYING:
                track.sight = "few"

    def followed(self, cloud, labels, verdicts, origin):
        """Verdicts on the unknown clusters that confirmed tracks follow: flying."""
        rules, more = self.c.classify, [BACKGROUND] * len(verdicts)
        newest = self.tracker.buffer[-1][0]
        tracks = [track for track in self.tracker.tracks if track.confirmed]
        for track in tracks if rules.follow_tracks else []:
            if track.seen != newest or track.points is None:
                continue
            rows = np.flatnonzero((cloud.astype(float) == track.points[0]).all(axis=1))
            label = labels[rows[0]]
            own = cloud[labels == label].astype(float)
            if (
                label >= 0
                and verdicts[label] == UNKNOWN
                and len(own) >= rules.min_points
                and np.linalg.norm(own.mean(axis=0) - origin) <= rules.max_distance
                and diagonal(own) <= rules.max_extent
            ):
                more[label] = FLYING
        return more

    def on_ground(self, cloud, labels):
        """Numbers of the clusters that confirmed tracks of ground movers follow."""
        newest, found = self.tracker.buffer[-1][0], []
        for track in self.tracker.tracks:
            is_followed = track.seen == newest and track.points is not None
            if track.confirmed and is_followed and track.kind == GROUND_KIND:
                rows = np.flatnonzero((cloud.astype(float) == track.points[0]).all(axis=1))
                found.append(labels[rows[0]])
        return [label for label in found if label >= 0]

    def frame(self, point_class, found, stamp, gate) -> Frame:
        tracks = []
        if gate != "open":
            point_class[point_class == FLYING] = UNKNOWN
            found = []
        else:
            shift = np.r_[self.origin, np.zeros(6)]
            tracks = [(n, x + shift, *more) for n, x, *more in self.tracker.reported(stamp)]
        rows = {
            name: np.array([one[name] for one in found]).reshape(-1, *shape)
            for name, shape in SHAPES.items()
        }
        rows["position"] = rows["position"] + self.origin
        return Frame(point_class, **rows, tracks=tracks, gate=gate)


CLUSTERING = {"max_distance", "min_points", "max_points"}
SHAPES = {
    "position": (3,),
    "covariance": (3, 3),
    "radius": (),
    "extent": (3,),
    "n_points": (),
    "confidence": (),
}
