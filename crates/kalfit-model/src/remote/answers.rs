//! Answers of the sites so far, and the next questions to the sites.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::remote::question::{Asked, Question};

/// Sums over tests, one for each requested quantity; `None` where the requested sum is not defined.
pub type Answer = Option<Vec<f64>>;

/// The sum of the answers of several sites to one question, in the order of the sites; `None` if two answers differ in
/// length.
pub fn sum(answers: &[Answer]) -> Option<Answer> {
    let length = answers.iter().flatten().map(Vec::len).next();
    if answers.iter().flatten().any(|one| Some(one.len()) != length) {
        return None;
    }
    let add = |mut sum: Vec<f64>, other: &Vec<f64>| {
        sum.iter_mut().zip(other).for_each(|(a, b)| *a += b);
        sum
    };
    let [first, rest @ ..] = answers else { return Some(None) };
    Some(rest.iter().fold(first.clone(), |sum, other| sum.zip(other.as_ref()).map(|(sum, other)| add(sum, other))))
}

/// All known answers about an ensemble, and the questions of a search without a known answer.
#[derive(Debug, Default)]
pub struct Answers {
    known: Vec<(Asked, Answer)>,
    pending: Mutex<PendingQuestions>,
}

#[derive(Debug, Default)]
struct PendingQuestions {
    /// Questions that were asked and have no answer yet.
    wanted: Vec<Asked>,
    /// Number of nested calls of `together` that collect questions.
    together: usize,
}

impl Answers {
    /// Answers for a search, from all known (question, answer) pairs.
    pub fn new(known: Vec<(Asked, Answer)>) -> Answers {
        Answers { known, pending: Mutex::default() }
    }

    /// Whether the search has put a question without a known answer: all results of the search after this question are
    /// meaningless.
    pub fn is_waiting(&self) -> bool {
        !self.pending().wanted.is_empty()
    }

    /// Questions that were asked and have no answer yet.
    pub fn wanted(&self) -> Vec<Asked> {
        self.pending().wanted.clone()
    }

    /// The answer to a question; `None` where the answer is not defined, or not known. The first question without an
    /// answer is recorded, and so are all questions [asked together](Answers::together) with this question.
    pub(crate) fn get(&self, asked: Asked) -> Answer {
        if !asked.is_finite() {
            return None;
        }
        if let Some((_, answer)) = self.known.iter().find(|(known, _)| *known == asked) {
            return answer.clone();
        }
        let mut pending = self.pending();
        if (pending.wanted.is_empty() || pending.together > 0) && !pending.wanted.contains(&asked) {
            pending.wanted.push(asked);
        }
        None
    }

    /// Runs `ask`, whose questions do not depend on each other, so that the sites answer all questions of `ask` in one
    /// round.
    pub fn together<T>(&self, ask: impl FnOnce() -> T) -> T {
        let opened = {
            let mut pending = self.pending();
            let opens = pending.wanted.is_empty() || pending.together > 0;
            pending.together += usize::from(opens);
            opens
        };
        let found = ask();
        self.pending().together -= usize::from(opened);
        found
    }

    fn pending(&self) -> MutexGuard<'_, PendingQuestions> {
        self.pending.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The remote tests, at a given α.
#[derive(Debug, Clone)]
pub struct Remote {
    /// The free values of α.
    pub values: Vec<f64>,
    /// All known answers, and the questions without an answer.
    pub answers: Arc<Answers>,
}

impl Remote {
    /// Answer of the tests to a question at this α.
    pub fn ask(&self, question: Question) -> Answer {
        self.answers.get(Asked { values: self.values.clone(), question })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asked(value: f64) -> Asked {
        Asked { values: vec![value], question: Question::Survey }
    }

    #[test]
    fn sums_add_number_by_number_and_what_one_cannot_answer_nobody_can() {
        let answers = [Some(vec![1.0, 2.0]), Some(vec![0.5, -1.0])];
        assert_eq!(sum(&answers), Some(Some(vec![1.5, 1.0])));
        assert_eq!(sum(&[answers[0].clone(), None]), Some(None));
        assert_eq!(sum(&[Some(vec![1.0]), answers[0].clone()]), None);
    }

    #[test]
    fn a_search_stops_at_the_first_question_without_an_answer_but_for_those_beside_it() {
        let answers = Answers::new(vec![(asked(1.0), Some(vec![3.0]))]);
        assert_eq!((answers.get(asked(1.0)), answers.is_waiting()), (Some(vec![3.0]), false));
        answers.together(|| (answers.get(asked(2.0)), answers.get(asked(f64::NAN)), answers.get(asked(3.0))));
        assert_eq!(answers.get(asked(4.0)), None);
        answers.together(|| answers.get(asked(5.0)));
        assert_eq!(answers.wanted(), [asked(2.0), asked(3.0)]);
        assert_eq!(answers.get(asked(1.0)), Some(vec![3.0]));
    }
}
