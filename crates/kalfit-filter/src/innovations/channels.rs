//! The innovations, separated by phase and measurement.

use std::ops::Range;

use crate::innovations::innovation::Innovation;

/// e/√S of each measurement of each phase, without measurements that have no innovations, in the order of phases and
/// measurements.
#[derive(Debug)]
pub(super) struct Channels {
    standardised: Vec<f64>,
    spans: Vec<ChannelSpan>,
}

#[derive(Debug)]
struct ChannelSpan {
    phase: usize,
    measurement: usize,
    range: Range<usize>,
}

/// The innovations of measurement `measurement` of phase `phase`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Channel<'a> {
    pub(super) phase: usize,
    pub(super) measurement: usize,
    /// e/√S, in the order of the filter.
    pub(super) standardised: &'a [f64],
}

impl Channels {
    /// Separates innovations that are in the order of the filter: phase after phase.
    pub(super) fn of(series: &[Innovation]) -> Channels {
        let mut channels = Channels { standardised: vec![0.0; series.len()], spans: Vec::new() };
        let mut start = 0;
        // for each measurement: first the number of innovations, then the index in `standardised` of the next
        // innovation
        let mut next = Vec::new();
        for phase in series.chunk_by(|a, b| a.phase == b.phase) {
            next.clear();
            for one in phase {
                next.resize(next.len().max(one.measurement + 1), 0);
                next[one.measurement] += 1;
            }
            for (measurement, next) in next.iter_mut().enumerate() {
                let range = start..start + *next;
                (start, *next) = (range.end, start);
                if !range.is_empty() {
                    channels.spans.push(ChannelSpan { phase: phase[0].phase, measurement, range });
                }
            }
            for one in phase {
                let place = &mut next[one.measurement];
                channels.standardised[*place] = one.standardised;
                *place += 1;
            }
        }
        channels
    }

    /// Each channel, in order.
    pub(super) fn each(&self) -> impl Iterator<Item = Channel<'_>> {
        let channel = |span: &ChannelSpan| Channel {
            phase: span.phase,
            measurement: span.measurement,
            standardised: &self.standardised[span.range.clone()],
        };
        self.spans.iter().map(channel)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_measurement_of_each_phase_has_its_own_in_order() {
        let one = |(number, &(phase, measurement)): (usize, &(usize, usize))| Innovation {
            phase,
            step: number,
            time: None,
            measurement,
            value: 0.0,
            variance: 1.0,
            standardised: number as f64,
        };
        let order = [(0, 2), (0, 0), (0, 2), (2, 1), (2, 0), (2, 1), (2, 1)];
        let series: Vec<Innovation> = order.iter().enumerate().map(one).collect();
        let channels = Channels::of(&series);
        let found: Vec<(usize, usize, Vec<f64>)> =
            channels.each().map(|c| (c.phase, c.measurement, c.standardised.to_vec())).collect();
        let expected = [(0, 0, vec![1.0]), (0, 2, vec![0.0, 2.0]), (2, 0, vec![4.0]), (2, 1, vec![3.0, 5.0, 6.0])];
        assert_eq!(found, expected);
        assert_eq!(Channels::of(&[]).each().count(), 0);
    }
}
