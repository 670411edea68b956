//! The 15 object categories of the paper and which of them training may see.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// Whether a category is seen in training or kept for judging generalisation (paper, section 5).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Split {
    /// One of the ten training categories.
    Train,
    /// One of the five novel categories.
    Novel,
}

macro_rules! categories {
    ($($name:ident => $split:ident),* $(,)?) => {
        /// A PartNet-Mobility category used by the paper.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
        #[allow(missing_docs, reason = "the names are the documentation")]
        pub enum Category { $($name),* }

        impl Category {
            /// All of them: training categories first, each group in alphabetical order.
            pub const ALL: [Category; 15] = [$(Category::$name),*];

            /// PartNet-Mobility's spelling.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self { $(Category::$name => stringify!($name)),* }
            }

            /// Whether training may see it.
            #[must_use]
            pub const fn split(self) -> Split {
                match self { $(Category::$name => Split::$split),* }
            }
        }
    };
}

categories! {
    Box => Train, Door => Train, Faucet => Train, Kettle => Train, Microwave => Train, Refrigerator => Train,
    StorageFurniture => Train, Switch => Train, TrashCan => Train, Window => Train,
    Bucket => Novel, KitchenPot => Novel, Safe => Novel, Table => Novel, WashingMachine => Novel,
}

impl fmt::Display for Category {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// A name that is none of the 15 categories.
#[derive(Debug, thiserror::Error)]
#[error("unknown category {0:?}, expected one of {names}", names = Category::ALL.map(Category::name).join(", "))]
pub struct UnknownCategory(String);

impl FromStr for Category {
    type Err = UnknownCategory;

    /// Ignores case.
    fn from_str(name: &str) -> Result<Self, Self::Err> {
        Self::ALL
            .into_iter()
            .find(|category| category.name().eq_ignore_ascii_case(name))
            .ok_or_else(|| UnknownCategory(name.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ten_are_seen_and_five_are_novel() {
        assert_eq!(Category::ALL.iter().filter(|c| c.split() == Split::Train).count(), 10);
        assert_eq!("kitchenpot".parse::<Category>().unwrap(), Category::KitchenPot);
        assert!("Sofa".parse::<Category>().unwrap_err().to_string().contains("StorageFurniture"));
    }
}
