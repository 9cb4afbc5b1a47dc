//! Conversion of the unit labels that datasheets use. All other labels are unchanged.

use std::f64::consts::PI;

use crate::time_unit;

/// m/s² in one g.
const GRAVITY: f64 = 9.80665;

/// Kind of quantity that a unit measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum UnitQuantity {
    /// An angular rate, shown in deg/h.
    Rate,
    /// An acceleration, shown in ug.
    Acceleration,
    /// An angle, in deg.
    Angle,
    /// A velocity, in m/s.
    Velocity,
    /// A fraction of something, in ppm.
    Part,
    /// Anything else, shown as it is labelled.
    Other,
}

/// A unit as a datasheet shows it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ShownUnit {
    pub(super) quantity: UnitQuantity,
    /// Factor that values are multiplied by.
    pub(super) factor: f64,
    pub(super) label: Option<String>,
}

impl ShownUnit {
    /// The shown unit for a unit label of the model.
    pub(super) fn shown(label: Option<&str>) -> ShownUnit {
        let own = label.map(str::trim);
        let known = |own: &str| {
            let (quantity, factor, label) = match own {
                "deg/h" => (UnitQuantity::Rate, 1.0, "deg/h"),
                "deg/s" => (UnitQuantity::Rate, 3600.0, "deg/h"),
                "rad/s" => (UnitQuantity::Rate, 3600.0 * 180.0 / PI, "deg/h"),
                "m/s^2" => (UnitQuantity::Acceleration, 1e6 / GRAVITY, "ug"),
                "g" => (UnitQuantity::Acceleration, 1e6, "ug"),
                "mg" => (UnitQuantity::Acceleration, 1e3, "ug"),
                "ug" => (UnitQuantity::Acceleration, 1.0, "ug"),
                "deg" => (UnitQuantity::Angle, 1.0, "deg"),
                "rad" => (UnitQuantity::Angle, 180.0 / PI, "deg"),
                "m/s" => (UnitQuantity::Velocity, 1.0, "m/s"),
                "ppm" => (UnitQuantity::Part, 1.0, "ppm"),
                _ => return None,
            };
            Some(ShownUnit { quantity, factor, label: Some(label.to_owned()) })
        };
        let other = || ShownUnit { quantity: UnitQuantity::Other, factor: 1.0, label: own.map(str::to_owned) };
        own.and_then(known).or_else(|| own.and_then(rate_per_quantity)).unwrap_or_else(other)
    }

    /// Factor and label of white noise in this unit, integrated over time, for a standard deviation of one and steps of
    /// one unit of time: a rate gives an angle, an acceleration a velocity.
    pub(super) fn white(&self, time: Option<&str>) -> (f64, Option<String>) {
        match (self.quantity, time.and_then(time_unit::hours)) {
            (UnitQuantity::Rate, Some(hours)) => (self.factor * hours.sqrt(), Some("deg/sqrt(h)".to_owned())),
            (UnitQuantity::Acceleration, Some(hours)) => {
                (self.factor * 1e-6 * GRAVITY * 3600.0 * hours.sqrt(), Some("m/s/sqrt(h)".to_owned()))
            }
            _ => (self.factor, self.density_label("*", time)),
        }
    }

    /// Factor and label of the density of noise that drives a state in this unit.
    pub(super) fn walk(&self, time: Option<&str>) -> (f64, Option<String>) {
        match (self.quantity, time.and_then(time_unit::hours)) {
            (UnitQuantity::Other | UnitQuantity::Part, _) | (_, None) => (self.factor, self.density_label("/", time)),
            (_, Some(hours)) => (self.factor / hours.sqrt(), self.density_label("/", Some("h"))),
        }
    }

    fn density_label(&self, sign: &str, time: Option<&str>) -> Option<String> {
        Some(format!("{}{sign}sqrt({})", self.label.as_ref()?, time?))
    }
}

/// Factor and label of a time in a unit of the model: parts of a second are shown in seconds.
pub(super) fn shown_time(unit: Option<&str>) -> (f64, Option<String>) {
    const SECOND: i128 = 1_000_000_000;
    match unit.and_then(time_unit::nanoseconds) {
        Some(part) if part < SECOND => (part as f64 / SECOND as f64, Some("s".to_owned())),
        _ => (1.0, unit.map(str::to_owned)),
    }
}

/// Unit of a rate or an acceleration per something else, such as `deg/s/g`.
fn rate_per_quantity(label: &str) -> Option<ShownUnit> {
    let rates = ["deg/h", "deg/s", "rad/s", "m/s^2", "mg", "ug", "g"];
    let (own, rest) = rates.iter().find_map(|own| Some((*own, label.strip_prefix(own)?)))?;
    let unit = ShownUnit::shown(Some(own));
    let label = Some(format!("{}{}", unit.label?, rest.strip_prefix('/').map(|rest| format!("/{rest}"))?));
    Some(ShownUnit { quantity: UnitQuantity::Other, factor: unit.factor, label })
}

#[cfg(test)]
mod tests {
    use kalfit_fixtures::near;

    use super::*;

    #[test]
    fn numbers_are_those_of_datasheets() {
        // 0.01 deg/s at 1 s: 0.01 deg/sqrt(s), 0.6 deg/sqrt(h)
        let (factor, label) = ShownUnit::shown(Some("deg/s")).white(Some("s"));
        near::relative("white noise of a rate", 0.01 * factor, 0.6, 1e-9);
        assert_eq!(label.as_deref(), Some("deg/sqrt(h)"));
        let (factor, _) = ShownUnit::shown(Some("deg/h")).white(Some("min"));
        near::relative("white noise over minutes", factor, 1.0 / 60.0_f64.sqrt(), 1e-9);
        // 1 mg at 1 s: 0.00980665 m/s/sqrt(s) over 3600 s, that is times 60
        let (factor, label) = ShownUnit::shown(Some("mg")).white(Some("s"));
        near::relative("white noise of an acceleration", factor, 0.00980665 * 60.0, 1e-9);
        assert_eq!(label.as_deref(), Some("m/s/sqrt(h)"));
        near::relative("m/s²", ShownUnit::shown(Some("m/s^2")).white(Some("s")).0, 60.0, 1e-9);
        let (factor, label) = ShownUnit::shown(Some("deg/s")).walk(Some("s"));
        near::relative("walk of a rate", factor, 3600.0 * 60.0, 1e-9);
        assert_eq!(label.as_deref(), Some("deg/h/sqrt(h)"));
        // 1 rad/s at 1 ns, and a walk of 1 rad/s per square root of a nanosecond
        let rate = ShownUnit::shown(Some("rad/s"));
        near::relative("ns, white", rate.white(Some("ns")).0, 180.0 / PI * 3600.0 / 3.6e12_f64.sqrt(), 1e-9);
        near::relative("ns, walk", rate.walk(Some("ns")).0, 180.0 / PI * 3600.0 * 3.6e12_f64.sqrt(), 1e-9);
        near::relative("d, walk", rate.walk(Some("d")).0, 180.0 / PI * 3600.0 / 24.0_f64.sqrt(), 1e-9);
        near::relative("rad", ShownUnit::shown(Some("rad")).walk(Some("h")).0, 57.29577951308232, 1e-9);
        near::relative("rad/s", ShownUnit::shown(Some("rad/s")).factor, 206264.80624709636, 1e-9);
    }

    #[test]
    fn other_labels_stay() {
        let unit = ShownUnit::shown(Some("furlong"));
        assert_eq!((unit.factor, unit.label.as_deref()), (1.0, Some("furlong")));
        assert_eq!(unit.walk(Some("s")), (1.0, Some("furlong/sqrt(s)".to_owned())));
        assert_eq!(ShownUnit::shown(Some("deg/s")).white(Some("frame")).1.as_deref(), Some("deg/h*sqrt(frame)"));
        assert_eq!(ShownUnit::shown(None).walk(Some("s")).1, None);
        let unit = ShownUnit::shown(Some("deg/s/g"));
        assert_eq!((unit.factor, unit.label.as_deref()), (3600.0, Some("deg/h/g")));
        assert_eq!(ShownUnit::shown(Some("gauss")).label.as_deref(), Some("gauss"));
    }
}
