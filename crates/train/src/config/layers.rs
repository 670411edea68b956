//! Files over files: a configuration that differs from another in a few lines has only these.

use std::path::{Path, PathBuf};

use toml::{Table, Value};

use super::ConfigError;

/// The field that names the file below, relative to the folder of the file that names it.
const BASE: &str = "base";

/// What a file says, over what its base says.
pub(super) fn read(path: &Path) -> Result<Table, ConfigError> {
    read_above(path, &mut Vec::new())
}

/// `above` are the files that have this one below them.
fn read_above(path: &Path, above: &mut Vec<PathBuf>) -> Result<Table, ConfigError> {
    let io = |source| ConfigError::Io { path: path.to_owned(), source };
    let file = path.canonicalize().map_err(io)?;
    if above.contains(&file) {
        return Err(ConfigError::Circle(path.to_owned()));
    }
    above.push(file);
    let text = std::fs::read_to_string(path).map_err(io)?;
    let mut table: Table = toml::from_str(&text).map_err(|error| ConfigError::syntax(path, &error))?;
    match table.remove(BASE) {
        None => Ok(table),
        Some(Value::String(base)) => {
            let below = read_above(&path.parent().unwrap_or(Path::new("")).join(base), above)?;
            Ok(over(table, below))
        }
        Some(other) => {
            Err(ConfigError::Value { field: BASE, found: other.to_string(), expected: "the name of a file" })
        }
    }
}

/// Tables are merged; everything else replaces what is below.
fn over(table: Table, mut below: Table) -> Table {
    for (key, value) in table {
        let merged = match (value, below.remove(&key)) {
            (Value::Table(own), Some(Value::Table(theirs))) => Value::Table(over(own, theirs)),
            (value, _) => value,
        };
        below.insert(key, merged);
    }
    below
}

#[cfg(test)]
mod tests {
    use super::super::{Decay, TrainConfig, tests::minimal};

    #[test]
    fn a_file_goes_over_its_base_and_never_over_itself() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
        let load = |name: &str| TrainConfig::load(&folder.path().join(name));
        std::fs::create_dir(folder.path().join("more")).unwrap();
        write(
            "base.toml",
            &format!("seed = 3\n{}decay = {{ step = {{ steps = 7, factor = 0.5 }} }}\n", minimal()),
        );
        write("middle.toml", "base = 'base.toml'\nseed = 4\n[schedule]\ndecay = 'cosine'\n");
        write("more/top.toml", "base = '../middle.toml'\n[schedule]\njoint_steps = 8\n[batch]\nviews = 3\n");
        let [base, top] = ["base.toml", "more/top.toml"].map(|name| load(name).unwrap());
        let mut expected = TrainConfig { seed: 4, ..base };
        expected.schedule.joint_steps = 8;
        expected.schedule.decay = Decay::Cosine;
        expected.batch.views = 3;
        assert_eq!(top, expected);

        write("circle.toml", "base = 'round.toml'\n");
        write("round.toml", "base = 'circle.toml'\n");
        write("number.toml", "base = 3\n");
        write("orphan.toml", "base = 'nothing.toml'\n");
        write("typo.toml", "base = 'base.toml'\n[batch]\nveiws = 3\n");
        let wrong = [
            ("circle.toml", "circle.toml: base goes round in a circle"),
            ("number.toml", "base is 3, expected the name of a file"),
            ("orphan.toml", "nothing.toml: No such file"),
            ("typo.toml", "typo.toml: unknown field `veiws`"),
        ];
        for (name, expected) in wrong {
            let error = load(name).unwrap_err().to_string();
            assert!(error.contains(expected), "{name}: {error}");
        }
    }
}
