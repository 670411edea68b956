//! The one thing that can be wrong with an input.

/// An input whose size does not fit.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ShapeError {
    what: String,
    expected: usize,
    found: usize,
}

impl ShapeError {
    /// Compares a size with the expected one.
    ///
    /// # Errors
    /// When they differ.
    pub fn check(what: &str, expected: usize, found: usize) -> Result<(), Self> {
        if expected == found { Ok(()) } else { Err(Self { what: what.to_owned(), expected, found }) }
    }
}

impl std::fmt::Display for ShapeError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: expected {}, found {}", self.what, self.expected, self.found)
    }
}

impl std::error::Error for ShapeError {}
