//! Buffer of the latest point clouds, sorted by stamp, for detections that arrive late.

use crate::Error;
use crate::util::budget::{MAX_POINTS, vec_with_capacity};
use crate::util::full_state::impossible;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Largest ratio of a cloud's memory to the needed memory. Memory with a larger ratio is not used
/// again.
const MOST_SPARE: usize = 4;

#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Cloud {
    pub(super) stamp_ns: i64,
    pub(super) points: Vec<[f32; 3]>,
    /// Time of every point after the stamp [s]; None if all are at the stamp.
    pub(super) delays: Option<Vec<f32>>,
}

impl Cloud {
    /// Fill this cloud with the finite points of a scan [m], or with none if `keeps_points` is
    /// false.
    ///
    /// # Errors
    /// [`Error::Limit`] for too many points, [`Error::Length`] for delays that do not fit.
    fn take(
        &mut self,
        points: &[[f32; 3]],
        delays: Option<&[f32]>,
        keeps_points: bool,
    ) -> Result<(), Error> {
        if let Some(delays) = delays.filter(|delays| delays.len() != points.len()) {
            let (expected, got) = (points.len(), delays.len());
            return Err(Error::Length { name: "point_time_ns", expected, got });
        }
        self.points.clear();
        if !keeps_points {
            self.delays = None;
            return Ok(());
        }
        let is_known = |point: &[f32; 3]| point.iter().all(|value| value.is_finite());
        let count = points.iter().filter(|point| is_known(point)).count();
        if self.points.capacity() < count || self.points.capacity() / MOST_SPARE > count {
            self.points = vec_with_capacity("a point cloud", count, MAX_POINTS, "split the scan")?;
        }
        self.points.extend(points.iter().copied().filter(is_known));
        match delays {
            Some(delays) => {
                let known = points.iter().zip(delays).filter(|(point, _)| is_known(point));
                let kept = self.delays.get_or_insert_default();
                kept.clear();
                kept.shrink_to(MOST_SPARE * count);
                kept.extend(known.map(|(_, &delay)| delay));
            }
            None => self.delays = None,
        }
        Ok(())
    }
}

#[derive(Debug)]
pub(super) struct Buffer {
    clouds: VecDeque<Cloud>,
    size: usize,
    /// A cloud that has left the buffer. Its memory is used for the next one.
    spare: Cloud,
}

impl Buffer {
    pub(super) fn new(size: usize) -> Self {
        Self { clouds: VecDeque::new(), size, spare: Cloud::default() }
    }

    /// A cloud with the finite points of a scan [m], or without points if `keeps_points` is false.
    ///
    /// # Errors
    /// [`Error::Limit`] for too many points, [`Error::Length`] for delays that do not fit.
    pub(super) fn copy(
        &mut self,
        points: &[[f32; 3]],
        delays: Option<&[f32]>,
        stamp_ns: i64,
        keeps_points: bool,
    ) -> Result<Cloud, Error> {
        let mut cloud = Cloud { stamp_ns, ..std::mem::take(&mut self.spare) };
        cloud.take(points, delays, keeps_points)?;
        Ok(cloud)
    }

    /// The clouds of the buffer, oldest first.
    pub(super) fn clouds(&self) -> &VecDeque<Cloud> {
        &self.clouds
    }

    /// Replace the clouds by those of a saved state.
    ///
    /// # Errors
    /// [`Error::Format`] for clouds that no buffer of this size holds.
    pub(super) fn restore(&mut self, clouds: VecDeque<Cloud>) -> Result<(), Error> {
        let fits = |cloud: &Cloud| {
            let count = cloud.points.len();
            cloud.delays.as_ref().is_none_or(|delays| delays.len() == count)
                && cloud.points.as_flattened().iter().all(|value| value.is_finite())
        };
        let newer = |(one, other): (&Cloud, &Cloud)| one.stamp_ns < other.stamp_ns;
        let is_sorted = clouds.iter().zip(clouds.iter().skip(1)).all(newer);
        if clouds.len() > self.size || !is_sorted || !clouds.iter().all(fits) {
            return Err(impossible("clouds that the buffer does not hold"));
        }
        self.clouds = clouds;
        Ok(())
    }

    /// True if the buffer holds a cloud of this stamp.
    pub(super) fn has(&self, stamp_ns: i64) -> bool {
        self.clouds.iter().any(|cloud| cloud.stamp_ns == stamp_ns)
    }

    /// True if a cloud of this stamp would be older than the newest cloud in the buffer.
    ///
    /// # Errors
    /// [`Error::Time`] if the buffer already holds this stamp, or is full and has only newer
    /// clouds.
    pub(super) fn is_late(&self, stamp_ns: i64) -> Result<bool, Error> {
        let refuse = |what| Err(Error::Time { what });
        if self.has(stamp_ns) {
            return refuse(format!(
                "point cloud at {stamp_ns} ns: expected a new stamp, a cloud of this one is known"
            ));
        }
        match (self.clouds.front(), self.clouds.back()) {
            (Some(oldest), Some(_))
                if self.clouds.len() >= self.size && stamp_ns < oldest.stamp_ns =>
            {
                refuse(format!(
                    "point cloud at {stamp_ns} ns: expected a stamp after {} ns, the oldest of the \
                     {} buffered clouds; raise `buffer_size` if clouds come this late",
                    oldest.stamp_ns, self.size
                ))
            }
            (_, Some(newest)) => Ok(stamp_ns < newest.stamp_ns),
            _ => Ok(false),
        }
    }

    /// Insert a cloud by its stamp. If the buffer was full, the oldest cloud leaves it.
    pub(super) fn push(&mut self, cloud: Cloud) {
        let place = self.clouds.partition_point(|other| other.stamp_ns < cloud.stamp_ns);
        self.clouds.insert(place, cloud);
        if self.clouds.len() > self.size {
            self.spare = self.clouds.pop_front().unwrap_or_default();
        }
    }

    /// The clouds of the buffer that are newer than `stamp_ns`, oldest first.
    pub(super) fn newer_than(&self, stamp_ns: i64) -> impl Iterator<Item = &Cloud> {
        self.clouds.iter().filter(move |cloud| cloud.stamp_ns > stamp_ns)
    }

    pub(super) fn newest_ns(&self) -> Option<i64> {
        self.clouds.back().map(|cloud| cloud.stamp_ns)
    }

    pub(super) fn clear(&mut self) {
        self.clouds.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clouds_that_no_scan_left_are_refused() {
        let cloud = |stamp_ns, x, delays| Cloud { stamp_ns, points: vec![[x, 0.0, 0.0]], delays };
        let restored = |clouds: [Cloud; 2]| Buffer::new(2).restore(clouds.into()).is_ok();
        assert!(restored([cloud(1, 1.0, None), cloud(2, -1e30, Some(vec![0.1]))]));
        assert!(!restored([cloud(2, 1.0, None), cloud(1, 1.0, None)]));
        assert!(!restored([cloud(1, 1.0, None), cloud(2, 1.0, Some(Vec::new()))]));
        for bad in [f32::NAN, f32::INFINITY] {
            assert!(!restored([cloud(1, 1.0, None), cloud(2, bad, None)]), "{bad}");
        }
    }
}
