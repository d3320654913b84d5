"""Small recordings in the form of Autoferry's."""

import json

from lidar_core.fusion.recordings.autoferry import DELAYS, SOURCES


def entry(sensor=1, time=10.0, measurement=(), own=(2.0, 1.0)):
    return {
        "sensorID": sensor,
        "time": time,
        "measurement": measurement,
        "ownshipPosition": list(own),
    }


def standing(one, east):
    """Truth of an entry, at the time of its measurement: targets by number, at x = `east` [m]."""
    time = one["time"] - DELAYS[SOURCES[one["sensorID"]]]
    return [{"targetID": number, "position": [0.0, x], "time": time} for number, x in east.items()]


def scenario(folder, entries, truth=None):
    """Write it; the file of detections."""
    path = folder / "scenario1_detections.json"
    path.write_text(json.dumps(entries))
    if truth is not None:
        (folder / "scenario1_groundTruth.json").write_text(json.dumps(truth))
    return path
