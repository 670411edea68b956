//! LZF, the compression of `binary_compressed` PCD files (format: liblzf by Marc Lehmann).
//!
//! A control byte below 32 announces that many + 1 literal bytes. Otherwise its upper three bits, plus one more byte
//! when they are all set, are a length - 2, and its lower five bits and the next byte a distance - 1 backwards.

/// Expands `input` to exactly `expected` bytes; `None` if it does not. Memory grows with what is produced, never
/// ahead of it.
pub(crate) fn decompress(mut input: &[u8], expected: usize) -> Option<Vec<u8>> {
    let mut output: Vec<u8> = Vec::with_capacity(expected.min(input.len().saturating_mul(4)));
    while let Some(control) = take(&mut input) {
        if control < 32 {
            let (literal, rest) = input.split_at_checked(usize::from(control) + 1)?;
            output.extend_from_slice(literal);
            input = rest;
        } else {
            let mut length = usize::from(control >> 5);
            if length == 7 {
                length += usize::from(take(&mut input)?);
            }
            let distance = (usize::from(control & 31) << 8 | usize::from(take(&mut input)?)) + 1;
            let start = output.len().checked_sub(distance)?;
            for i in start..start + length + 2 {
                // Source and target may overlap: that is how runs are stored.
                output.push(*output.get(i)?);
            }
        }
        if output.len() > expected {
            return None;
        }
    }
    (output.len() == expected).then_some(output)
}

fn take(input: &mut &[u8]) -> Option<u8> {
    let (&first, rest) = input.split_first()?;
    *input = rest;
    Some(first)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn literals_runs_and_long_matches() {
        // "abc", then 9 bytes from 3 back.
        let packed = [2, b'a', b'b', b'c', 7 << 5, 0, 2];
        assert_eq!(decompress(&packed, 12).unwrap(), b"abcabcabcabc");
        assert!(decompress(&packed, 11).is_none());
        assert!(decompress(&packed[..5], 12).is_none());
        assert!(decompress(&[1 << 5, 9], 3).is_none(), "a match before the start");
    }
}
