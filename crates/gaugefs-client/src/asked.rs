// SPDX-License-Identifier: MIT

//! Requests to a file of `gauge/` that several programs may make: a name tells each answer.

use std::hash::{BuildHasher, Hasher, RandomState};
use std::thread;
use std::time::Duration;

/// How often a request is repeated after another program's answer.
pub const TRIES: u32 = 5;

/// A request's name, with which its answer begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Name(u64);

impl Name {
    /// A name that no other request has.
    pub fn draw() -> Self {
        Self(RandomState::new().build_hasher().finish())
    }

    /// The request with its name.
    pub fn on(self, request: &str) -> String {
        format!("{request} #{:016x}", self.0)
    }

    /// The answer's text; `None` if it answers another request.
    pub fn answer(self, text: &str) -> Option<&str> {
        text.strip_prefix(&format!("#{:016x}\n", self.0))
    }

    /// Waits for a random time, so that two programs do not collide again.
    pub fn pause(self) {
        thread::sleep(Duration::from_millis(self.0 % 400));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_answer_is_known_by_the_name_of_its_request() {
        let [own, other] = [Name::draw(), Name::draw()];
        assert_ne!(own, other);
        let request = own.on("undo 0x0001");
        let title = request.strip_prefix("undo 0x0001 ").expect("a name").to_string();
        assert_eq!(own.answer(&format!("{title}\nundone\n")), Some("undone\n"));
        assert_eq!(other.answer(&format!("{title}\nundone\n")), None);
        assert_eq!(own.answer("nothing to settle\n"), None);
    }
}
