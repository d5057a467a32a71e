//! Messages of the dashboard to its user: the answer to a request, the result of writing a file. Each is shown in full until
//! there was time to read it.

use std::collections::VecDeque;

/// Time for which a good answer is shown, and a bad one, s.
const GOOD_S: f64 = 6.0;
const BAD_S: f64 = 20.0;
/// Most answers on the screen: the oldest makes room.
const MOST: usize = 5;

/// One answer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Answer {
    /// For the user.
    pub text: String,
    /// True if the request was carried out.
    pub good: bool,
}

impl Answer {
    /// It was done.
    pub fn good(text: impl Into<String>) -> Self {
        Self { text: text.into(), good: true }
    }

    /// It was not done.
    pub fn bad(text: impl Into<String>) -> Self {
        Self { text: text.into(), good: false }
    }
}

impl From<Result<String, String>> for Answer {
    fn from(outcome: Result<String, String>) -> Self {
        outcome.map_or_else(Self::bad, Self::good)
    }
}

/// The answers on the screen, oldest first.
#[derive(Default)]
pub struct Answers {
    shown: VecDeque<(f64, Answer)>,
}

impl Answers {
    /// Shows an answer from `now_s` on. One that is on the screen already stays longer instead of coming twice.
    pub fn add(&mut self, answer: Answer, now_s: f64) {
        let until_s = now_s + if answer.good { GOOD_S } else { BAD_S };
        self.shown.retain(|(_, other)| *other != answer);
        self.shown.push_back((until_s, answer));
        if self.shown.len() > MOST {
            self.shown.pop_front();
        }
    }

    /// Returns the answers on the screen at `now_s`.
    pub fn at(&mut self, now_s: f64) -> impl Iterator<Item = &Answer> {
        self.shown.retain(|(until_s, _)| *until_s > now_s);
        self.shown.iter().map(|(_, answer)| answer)
    }

    /// Takes one from the screen.
    pub fn dismiss(&mut self, index: usize) {
        self.shown.remove(index);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn refusal_is_shown_longer_than_success() {
        let mut answers = Answers::default();
        answers.add(Answer::good("done"), 1.0);
        answers.add(Answer::bad("refused"), 1.0);
        answers.add(Answer::bad("refused"), 2.0);
        let texts = |answers: &mut Answers, now_s| -> Vec<String> {
            answers.at(now_s).map(|answer| answer.text.clone()).collect()
        };
        assert_eq!(texts(&mut answers, 3.0), ["done", "refused"]);
        assert_eq!(texts(&mut answers, 21.5), ["refused"]);
        assert!(texts(&mut answers, 22.5).is_empty());
        (0..9).for_each(|i| answers.add(Answer::bad(i.to_string()), 30.0));
        answers.dismiss(0);
        assert_eq!(texts(&mut answers, 31.0), ["5", "6", "7", "8"]);
    }
}
