//! Objects from a seed: generators for all categories.
//!
//! Every object is a function of its category and seed. Sizes follow PartNet-Mobility: the whole object fits into the
//! unit sphere, its front faces -x. Bodies are hollow where real ones are, and every solid brings its convex pieces.

mod builder;
mod carcass;
mod carton;
mod cells;
mod controls;
mod dice;
mod door;
mod faucet;
mod finish;
mod fridge;
mod handle;
mod kettle;
mod lathe;
mod microwave;
mod panel;
mod safe;
mod solid;
mod storage;
mod sweep;
mod switch;
mod table;
#[cfg(test)]
mod tests;
mod texture;
mod trash_can;
mod vessels;
mod washer;
mod window;

use where2act_core::{Category, Seed};

use self::builder::Builder;
use self::dice::Dice;
use super::Object;

/// The object of a category with this seed, named `Category:SEED`. Never fails; the same arguments give the same object.
#[must_use]
pub fn generate(category: Category, seed: Seed) -> Object {
    let dice = Dice(seed.child(category.name(), 0).rng());
    let (root, build): (&'static str, fn(&mut Builder)) = match category {
        Category::Box => ("box_body", carton::build),
        Category::Door => ("door_frame", door::build),
        Category::Faucet => ("faucet_base", faucet::build),
        Category::Kettle => ("kettle_body", kettle::build),
        Category::Microwave => ("microwave_body", microwave::build),
        Category::Refrigerator => ("refrigerator_body", fridge::build),
        Category::StorageFurniture => ("furniture_body", storage::build),
        Category::Switch => ("switch_frame", switch::build),
        Category::TrashCan => ("trashcan_body", trash_can::build),
        Category::Window => ("window_frame", window::build),
        Category::Bucket => ("bucket_body", vessels::bucket),
        Category::KitchenPot => ("pot_body", vessels::pot),
        Category::Safe => ("safe_body", safe::build),
        Category::Table => ("table_body", table::build),
        Category::WashingMachine => ("washer_body", washer::build),
    };
    let mut builder = Builder::new(dice, root);
    build(&mut builder);
    builder.finish(format!("{category}:{}", seed.0), category)
}
