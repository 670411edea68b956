//! Errors as users read them.

use std::error::Error;

/// An error and its causes in one line, for the end of a program. A cause that the text before it tells already is
/// not told again.
#[must_use]
pub fn one_line(error: &(dyn Error + 'static)) -> String {
    let mut line = String::new();
    let mut next = Some(error);
    while let Some(cause) = next {
        let text = cause.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
        if line.is_empty() {
            line = text;
        } else if !line.contains(&text) {
            line = format!("{line}: {text}");
        }
        next = cause.source();
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, thiserror::Error)]
    enum Failed {
        #[error("model.bin: {source}")]
        Telling { source: std::io::Error },
        #[error("--weights")]
        Silent { source: Box<Failed> },
    }

    #[test]
    fn every_cause_is_told_once_and_on_one_line() {
        let telling = Failed::Telling { source: std::io::Error::other("no such\n  file") };
        assert_eq!(one_line(&telling), "model.bin: no such file");
        let silent = Failed::Silent { source: Box::new(telling) };
        assert_eq!(one_line(&silent), "--weights: model.bin: no such file");
    }
}
