//! The classes of an ensemble one by one. Passes work on blocks of them, so that classes whose noise is scaled are made when somebody
//! asks for them, and only then.

use std::ops::Deref;
use std::sync::{Arc, OnceLock};

use crate::estimate::class::Class;

/// Classes in an order that does not depend on the order of the tests.
#[derive(Debug, Clone)]
pub(crate) struct Listed {
    gathered: Arc<Vec<Class>>,
    /// What has become of them since.
    noise: Option<Noise>,
    made: OnceLock<Vec<Class>>,
}

/// All noise λ times as large, in coordinates that are √λ times as large: R stays, d is d/√λ.
#[derive(Debug, Clone)]
pub(crate) struct Noise {
    pub(crate) variance: f64,
    /// Of each class.
    pub(crate) told: Arc<Vec<Residual>>,
}

/// What tests say of the level of the noise by themselves.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Residual {
    /// n.
    pub(crate) measurements: f64,
    /// r.
    pub(crate) squares: f64,
}

impl Residual {
    pub(crate) fn and(self, other: Residual) -> Residual {
        Residual { measurements: self.measurements + other.measurements, squares: self.squares + other.squares }
    }

    /// What is added to the constant where all noise is so many times as large: -½ n log λ - ½ r (1/λ - 1).
    pub(crate) fn change(self, variance: f64) -> f64 {
        -0.5 * (self.measurements * variance.ln() + self.squares * (variance.recip() - 1.0))
    }
}

impl Noise {
    /// 1/√λ.
    pub(crate) fn unit(&self) -> f64 {
        self.variance.sqrt().recip()
    }

    fn of(&self, class: &Class, told: Residual) -> Class {
        let unit = self.unit();
        let shrunk = |numbers: &[f64]| numbers.iter().map(|x| x * unit).collect();
        Class {
            constant: class.constant + told.change(self.variance),
            mean: shrunk(&class.mean),
            scatter: shrunk(&class.scatter),
            ..class.clone()
        }
    }
}

impl Listed {
    /// These classes.
    pub(crate) fn new(classes: Vec<Class>) -> Listed {
        Listed { gathered: Arc::new(classes), noise: None, made: OnceLock::new() }
    }

    /// The same with other noise than they were gathered with.
    pub(crate) fn with(&self, noise: Noise) -> Listed {
        Listed { gathered: self.gathered.clone(), noise: Some(noise), made: OnceLock::new() }
    }

    /// As they were gathered, whatever their noise is now.
    pub(crate) fn gathered(&self) -> &[Class] {
        &self.gathered
    }

    /// What d is now multiplied by.
    pub(crate) fn unit(&self) -> f64 {
        self.noise.as_ref().map_or(1.0, Noise::unit)
    }

    /// Every so-many-th of them.
    pub(crate) fn thinned(&self, every: usize) -> Vec<Class> {
        let numbers = (0..self.len()).skip(every / 2).step_by(every);
        let one = |k: usize| match &self.noise {
            Some(noise) => noise.of(&self.gathered[k], noise.told[k]),
            None => self.gathered[k].clone(),
        };
        numbers.map(one).collect()
    }

    /// How many they are.
    pub(crate) fn len(&self) -> usize {
        self.gathered.len()
    }
}

impl Deref for Listed {
    type Target = [Class];

    fn deref(&self) -> &[Class] {
        let Some(noise) = &self.noise else { return &self.gathered };
        self.made.get_or_init(|| {
            let all = self.gathered.iter().zip(noise.told.iter());
            all.map(|(class, told)| noise.of(class, *told)).collect()
        })
    }
}
