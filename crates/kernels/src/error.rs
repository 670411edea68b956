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

    /// Multiplies sizes.
    ///
    /// # Errors
    /// When the product is no number of values that memory could hold.
    pub(crate) fn product(what: &str, sizes: &[usize]) -> Result<usize, Self> {
        let product = sizes.iter().try_fold(1usize, |product, &size| product.checked_mul(size));
        let limit = isize::MAX as usize / size_of::<f32>();
        let too_many = || Self { what: format!("{what}, at most"), expected: limit, found: usize::MAX };
        product.filter(|&product| product <= limit).ok_or_else(too_many)
    }
}

impl std::fmt::Display for ShapeError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}: expected {}, found {}", self.what, self.expected, self.found)
    }
}

impl std::error::Error for ShapeError {}
