//! Tables of trials: tab-separated, one trial a line, the columns named by the first line.

use std::collections::HashMap;
use std::fmt::Write as _;
use std::str::FromStr;
use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;
use where2act_core::{Grasp, Primitive, Verdict};

use super::{Attempt, Mode};
use crate::object::Object;
use crate::scene::{Scene, SettledScene, Unsettled};

/// Columns that every table has.
const INPUT: [&str; 11] = ["primitive", "target_link", "px", "py", "pz", "ax", "ay", "az", "fx", "fy", "fz"];
/// Columns that say what came of a trial: written, and compared where the input has them.
const OUTCOME: [&str; 5] = ["valid", "reason", "q_start", "q_end", "success"];

/// A line of a table that cannot be a trial.
#[derive(Debug, thiserror::Error)]
#[error("line {line}: {why}")]
pub struct BatchError {
    /// Counted from 1, the header included.
    pub line: usize,
    /// Expected and found.
    pub why: String,
}

/// A table of trials on one object.
pub struct Batch {
    object: Arc<Object>,
    header: Vec<String>,
    rows: Vec<Row>,
}

struct Row {
    fields: Vec<String>,
    attempt: Attempt,
    q: Vec<f32>,
    expected_valid: Option<bool>,
    expected_success: Option<bool>,
}

/// How many outcomes are as the input says.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Agreement {
    /// Rows that say whether the trial is valid, and those of them that agree.
    pub valid: (usize, usize),
    /// Rows that say whether the trial succeeds, and those of them that agree.
    pub success: (usize, usize),
}

/// What came of a row.
#[derive(Clone, Debug, PartialEq)]
pub enum Outcome {
    /// The trial was run.
    Run(Verdict),
    /// Its scene does not come to rest, so there was no trial.
    NoScene(Unsettled),
}

impl Outcome {
    fn is_valid(&self) -> bool {
        matches!(self, Self::Run(verdict) if verdict.invalid.is_none())
    }

    fn is_success(&self) -> bool {
        matches!(self, Self::Run(verdict) if verdict.success)
    }
}

impl Batch {
    /// Reads a table. The columns are `primitive`, `target_link`, `px py pz` (contact point), `ax ay az` (approach),
    /// `fx fy fz` (forward), all in the world frame; `q_<link>` for start positions of the joints that move these
    /// links (closed if there is no such column); and outcomes (`valid`, `reason`, `q_start`, `q_end`, `success`).
    ///
    /// # Errors
    /// [`BatchError`] names the first line that cannot be understood.
    pub fn parse(text: &str, object: Arc<Object>) -> Result<Self, BatchError> {
        let mut lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
        let at = |line: usize| move |why: String| BatchError { line: line + 1, why };
        let header: Vec<String> = match lines.next() {
            Some((_, line)) => line.split('\t').map(str::to_owned).collect(),
            None => return Err(at(0)("expected a line of column names, found nothing".to_owned())),
        };
        let columns = Columns::new(&header, &object).map_err(at(0))?;
        let row = |(number, line): (usize, &str)| columns.row(line, &object).map_err(at(number));
        let rows = lines.map(row).collect::<Result<_, _>>()?;
        Ok(Self { object, header, rows })
    }

    /// Number of trials.
    #[must_use]
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// The trials, without their scenes.
    pub fn attempts(&self) -> impl Iterator<Item = &Attempt> {
        self.rows.iter().map(|row| &row.attempt)
    }

    /// Whether there are no trials.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// Runs all trials on the current rayon pool; `done` is called after each. Scenes that several rows share are
    /// settled once. Outcomes are in the order of the rows and do not depend on the number of threads.
    pub fn run(&self, mode: Mode, settle: bool, done: impl Fn() + Sync) -> Vec<Outcome> {
        let key = |row: &Row| row.q.iter().map(|q| q.to_bits()).collect::<Vec<_>>();
        let mut scene_of = HashMap::new();
        let mut starts = Vec::new();
        for row in &self.rows {
            scene_of.entry(key(row)).or_insert_with(|| {
                starts.push(&row.q);
                starts.len() - 1
            });
        }
        let scenes: Vec<Result<SettledScene, Unsettled>> = starts
            .par_iter()
            .map(|q| {
                let scene = Scene { object: Arc::clone(&self.object), q: q.to_vec() };
                if settle { scene.settle() } else { scene.assume_settled() }
            })
            .collect();
        let outcome = |row: &Row| {
            let outcome = match &scenes[scene_of[&key(row)]] {
                Ok(scene) => Outcome::Run(scene.attempt(&row.attempt, mode, None)),
                Err(unsettled) => Outcome::NoScene(unsettled.clone()),
            };
            done();
            outcome
        };
        self.rows.par_iter().with_max_len(1).map(outcome).collect()
    }

    /// Counts where outcomes are as the table says.
    #[must_use]
    pub fn agreement(&self, outcomes: &[Outcome]) -> Agreement {
        let mut agreement = Agreement::default();
        for (row, outcome) in self.rows.iter().zip(outcomes) {
            let count = |said: Option<bool>, is: bool, (all, agreeing): (usize, usize)| match said {
                Some(said) => (all + 1, agreeing + usize::from(said == is)),
                None => (all, agreeing),
            };
            agreement.valid = count(row.expected_valid, outcome.is_valid(), agreement.valid);
            agreement.success = count(row.expected_success, outcome.is_success(), agreement.success);
        }
        agreement
    }

    /// The table with its outcome columns filled in; those that it lacks are appended.
    #[must_use]
    pub fn to_tsv(&self, outcomes: &[Outcome]) -> String {
        let mut header = self.header.clone();
        header.extend(
            OUTCOME.iter().filter(|name| !self.header.iter().any(|h| h == *name)).map(|n| (*n).to_owned()),
        );
        let mut text = header.join("\t");
        text.push('\n');
        for (row, outcome) in self.rows.iter().zip(outcomes) {
            let fields = header.iter().enumerate().map(|(i, name)| match outcome_field(name, outcome) {
                Some(field) => field,
                None => row.fields.get(i).cloned().unwrap_or_default(),
            });
            let _ = writeln!(text, "{}", fields.collect::<Vec<_>>().join("\t"));
        }
        text
    }
}

fn outcome_field(column: &str, outcome: &Outcome) -> Option<String> {
    let verdict = match outcome {
        Outcome::Run(verdict) => Some(verdict),
        Outcome::NoScene(_) => None,
    };
    let number = |q: fn(&Verdict) -> f32| verdict.map_or_else(String::new, |v| format!("{:.6}", q(v)));
    Some(match column {
        "valid" => u8::from(outcome.is_valid()).to_string(),
        "success" => u8::from(outcome.is_success()).to_string(),
        "q_start" => number(|v| v.q_start),
        "q_end" => number(|v| v.q_end),
        "reason" => match outcome {
            Outcome::Run(verdict) => verdict.invalid.map_or_else(String::new, |reason| reason.to_string()),
            Outcome::NoScene(unsettled) => match unsettled {
                Unsettled::Piece(_) => "bad-piece",
                Unsettled::PartsCollide(..) => "parts-collide",
                Unsettled::NeverStill => "never-still",
                Unsettled::Unstable => "unstable",
            }
            .to_owned(),
        },
        _ => return None,
    })
}

/// Where a table has what.
struct Columns<'a> {
    header: &'a [String],
    input: [usize; INPUT.len()],
    /// Column and index of the joint.
    q: Vec<(usize, usize)>,
    valid: Option<usize>,
    success: Option<usize>,
}

impl<'a> Columns<'a> {
    fn new(header: &'a [String], object: &Object) -> Result<Self, String> {
        let place = |name: &str| header.iter().position(|h| h == name);
        let mut input = [0; INPUT.len()];
        for (place_of, name) in input.iter_mut().zip(INPUT) {
            *place_of =
                place(name).ok_or_else(|| format!("expected a column {name}, found {}", header.join(" ")))?;
        }
        let mut q = Vec::new();
        for (column, name) in header.iter().enumerate() {
            if INPUT.contains(&name.as_str()) || OUTCOME.contains(&name.as_str()) {
                continue;
            }
            let link =
                name.strip_prefix("q_").and_then(|link| object.find_link(link)).filter(|link| *link > 0);
            let link = link.ok_or_else(|| {
                let links: Vec<_> = object.movable().map(|l| object.links[l].name.as_str()).collect();
                format!(
                    "unknown column {name:?}, expected q_<link> with one of the links {}",
                    links.join(", ")
                )
            })?;
            q.push((column, link - 1));
        }
        Ok(Self { header, input, q, valid: place("valid"), success: place("success") })
    }

    fn row(&self, line: &str, object: &Arc<Object>) -> Result<Row, String> {
        let fields: Vec<String> = line.split('\t').map(|field| field.trim().to_owned()).collect();
        if fields.len() != self.header.len() {
            return Err(format!("expected {} columns, found {}", self.header.len(), fields.len()));
        }
        let mut numbers = [0.0; 9];
        for (number, (column, name)) in numbers.iter_mut().zip(self.input.iter().zip(INPUT).skip(2)) {
            *number = finite(name, &fields[*column])?;
        }
        let [px, py, pz, ax, ay, az, fx, fy, fz] = numbers;
        let (approach, forward) = (Vector3::new(ax, ay, az), Vector3::new(fx, fy, fz));
        if approach.cross(&forward).norm() <= 1e-6 * approach.norm() * forward.norm() {
            return Err(format!(
                "expected approach and forward to span a plane, found {ax} {ay} {az} and {fx} {fy} {fz}"
            ));
        }
        let name = &fields[self.input[1]];
        let link = object.find_link(name).filter(|link| *link > 0).ok_or_else(|| {
            let links: Vec<_> = object.movable().map(|l| object.links[l].name.as_str()).collect();
            format!("unknown link {name:?} in target_link, expected one of {}", links.join(", "))
        })?;
        let mut q = object.closed();
        for (column, joint) in &self.q {
            q[*joint] = finite(&self.header[*column], &fields[*column])?;
        }
        let q = Scene::new(Arc::clone(object), q).map_err(|e| e.to_string())?.q;
        let attempt = Attempt {
            primitive: Primitive::from_str(&fields[self.input[0]]).map_err(|e| e.to_string())?,
            link,
            grasp_in_world: Grasp::new(Point3::new(px, py, pz), approach, forward),
            normal_in_world: None,
        };
        let flag = |column: Option<usize>, name: &str| match column.map(|c| fields[c].as_str()) {
            None | Some("") => Ok(None),
            Some("0" | "false") => Ok(Some(false)),
            Some("1" | "true") => Ok(Some(true)),
            Some(other) => Err(format!("expected 0 or 1 in {name}, found {other:?}")),
        };
        let expected_valid = flag(self.valid, "valid")?;
        let expected_success = flag(self.success, "success")?;
        Ok(Row { attempt, q, expected_valid, expected_success, fields })
    }
}

fn finite(column: &str, field: &str) -> Result<f32, String> {
    let number = field.parse::<f32>().ok().filter(|x| x.is_finite());
    number.ok_or_else(|| format!("expected a finite number in {column}, found {field:?}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::object;

    #[test]
    fn mistakes_are_told_by_line_and_column() {
        let object = Arc::new(object::open("Microwave:1").unwrap());
        let link = &object.links[1].name;
        let header = format!("{}\tq_{link}", INPUT.join("\t"));
        let row = |px: &str, q: &str| format!("pushing\t{link}\t{px}\t0\t0\t1\t0\t0\t0\t1\t0\t{q}");
        let parse = |row: String| Batch::parse(&format!("{header}\n\n{row}\n"), Arc::clone(&object));
        assert_eq!(parse(row("0", "0")).unwrap().len(), 1);
        for (row, column, found) in
            [(row("0", "ajar"), format!("q_{link}"), "ajar"), (row("", "0"), "px".into(), "")]
        {
            let error = parse(row).err().expect("a mistake").to_string();
            assert_eq!(error, format!("line 3: expected a finite number in {column}, found {found:?}"));
        }
    }
}
