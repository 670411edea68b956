//! Which objects may be trained on.

use serde::{Deserialize, Serialize};
use where2act_core::{Category, Split, sha256_hex};
use where2act_sim::collect::ObjectSet;
use where2act_sim::object::unvaried;

/// What an object is used for. A pure function of its name and category, so no data set can leak into another.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Part {
    /// Seen in training.
    Train,
    /// Picks the best weights.
    Validation,
    /// Judges unseen shapes of the training categories.
    Shapes,
    /// Judges novel categories: every object of the five.
    Novel,
}

impl Part {
    /// Where an object belongs. Generated objects (`Category:SEED`) with a seed of [`ObjectSet::TEST_SEEDS`] judge
    /// shapes; of the others one in ten validates. Of objects from folders one in ten validates and one in ten judges
    /// shapes. Variations belong where the object does. Objects without a category count as a training category's.
    #[must_use]
    pub fn of(object: &str, category: Option<Category>) -> Self {
        if category.is_some_and(|c| c.split() == Split::Novel) {
            return Self::Novel;
        }
        if let (of, Some(_)) = unvaried(object) {
            return Self::of(of, category);
        }
        let seed = object.rsplit_once(':').and_then(|(_, seed)| seed.parse().ok());
        if seed.is_some_and(|seed: u64| ObjectSet::TEST_SEEDS.contains(&seed)) {
            return Self::Shapes;
        }
        // A hash of the name, not its number: neighbouring seeds spread evenly. `Box/31`, which is `31` to whoever names the
        // folder `Box`, is one object.
        let digest = match (seed, category) {
            (None, Some(category)) => {
                let id = object.rsplit('/').next().unwrap_or(object);
                sha256_hex(format!("{category}/{id}").as_bytes())
            }
            _ => sha256_hex(object.as_bytes()),
        };
        match u32::from_str_radix(&digest[..8], 16).unwrap_or(0) % 10 {
            0 => Self::Validation,
            1 if seed.is_none() => Self::Shapes,
            _ => Self::Train,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nine_in_ten_generated_objects_train_and_novel_ones_never() {
        let parts: Vec<_> = (0..1000).map(|i| Part::of(&format!("Door:{i}"), Some(Category::Door))).collect();
        let share = |part| parts.iter().filter(|p| **p == part).count() as f64 / 1000.0;
        assert!((share(Part::Train) - 0.9).abs() < 0.03);
        assert!((share(Part::Validation) - 0.1).abs() < 0.03);
        assert!((0..100).all(|i| Part::of(&format!("Safe:{i}"), Some(Category::Safe)) == Part::Novel));
    }

    #[test]
    fn variations_belong_where_the_object_does() {
        for seed in 0..200 {
            let of = |suffix: &str| Part::of(&format!("Door:{seed}{suffix}"), Some(Category::Door));
            assert_eq!(of("~7"), of(""));
        }
        for of_a_test_object in ["Faucet:1000003~12", "Faucet:1000003~12~1"] {
            assert_eq!(Part::of(of_a_test_object, Some(Category::Faucet)), Part::Shapes);
        }
        assert_eq!(Part::of("Box/31~5", Some(Category::Box)), Part::of("Box/31", Some(Category::Box)));
    }

    #[test]
    fn test_seeds_judge_and_objects_from_folders_are_split_too() {
        for seed in ObjectSet::TEST_SEEDS {
            assert_eq!(Part::of(&format!("Faucet:{seed}"), Some(Category::Faucet)), Part::Shapes);
        }
        let parts: Vec<_> = (0..500).map(|i| Part::of(&format!("Box/{i}"), Some(Category::Box))).collect();
        for part in [Part::Train, Part::Validation, Part::Shapes] {
            assert!(parts.contains(&part));
        }
        for folder in ["", "boxes/"] {
            let others = (0..500).map(|i| Part::of(&format!("{folder}{i}"), Some(Category::Box)));
            assert!(others.eq(parts.iter().copied()), "whichever folder collecting was given");
        }
    }
}
