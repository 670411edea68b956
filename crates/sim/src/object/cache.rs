//! Convex pieces on disk, by content, so that an object is decomposed once.
//!
//! One file per object: its name is the hash of all its collision meshes and of the rules, its last 64 bytes are
//! the hash of what stands before. Nothing about the cache is ever an error.

use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use nalgebra::Point3;
use rayon::prelude::*;
use sha2::{Digest, Sha256};
use tracing::debug;
use where2act_core::{sha256_hex, write_whole};

use super::ConvexPiece;
use super::convex::{RULES, decompose};
use super::soup::Soup;

/// The convex pieces of each mesh, kept in `folder` if there is one.
pub(super) fn pieces(meshes: &[Soup], folder: Option<&Path>) -> Vec<Vec<ConvexPiece>> {
    let file = folder.map(|f| f.join(format!("convex-{}", key(meshes))));
    if let Some(known) =
        file.as_ref().and_then(|f| fs::read(f).ok()).and_then(|bytes| decode(&bytes, meshes.len()))
    {
        return known;
    }
    let pieces: Vec<_> = meshes.par_iter().map(decompose).collect();
    if let Some(file) = file
        && let Err(e) = write_whole(&file, |w| w.write_all(&encode(&pieces)))
    {
        debug!("{}: convex pieces are not kept: {e}", file.display());
    }
    pieces
}

/// `$WHERE2ACT_CACHE`, else the user's cache folder; `None` if there is no such thing or the variable is empty.
pub(super) fn default_folder() -> Option<PathBuf> {
    if let Some(path) = std::env::var_os("WHERE2ACT_CACHE") {
        return (!path.is_empty()).then(|| path.into());
    }
    let named = |name: &str| std::env::var_os(name).filter(|v| !v.is_empty()).map(PathBuf::from);
    let base = named("XDG_CACHE_HOME")
        .or_else(|| named("LOCALAPPDATA"))
        .or_else(|| Some(named("HOME")?.join(".cache")));
    base.map(|b| b.join("where2act"))
}

fn key(meshes: &[Soup]) -> String {
    let mut hash = Sha256::new();
    hash.update(RULES);
    for mesh in meshes {
        hash.update((mesh.points.len() as u64).to_le_bytes());
        hash.update((mesh.triangles.len() as u64).to_le_bytes());
        let points = mesh.points.iter().flat_map(|p| [p.x, p.y, p.z]).flat_map(f32::to_le_bytes);
        let corners = mesh.triangles.iter().flatten().copied().flat_map(u32::to_le_bytes);
        hash.update(points.chain(corners).collect::<Vec<u8>>());
    }
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Counts as u32 and coordinates as f32, little-endian: per mesh its pieces, per piece its corners.
fn encode(meshes: &[Vec<ConvexPiece>]) -> Vec<u8> {
    let mut bytes = Vec::new();
    for pieces in meshes {
        bytes.extend((pieces.len() as u32).to_le_bytes());
        for piece in pieces {
            bytes.extend((piece.points.len() as u32).to_le_bytes());
            bytes.extend(piece.points.iter().flat_map(|p| [p.x, p.y, p.z]).flat_map(f32::to_le_bytes));
        }
    }
    let hash = sha256_hex(&bytes);
    bytes.extend(hash.as_bytes());
    bytes
}

/// `None` if a single byte is not as it was written.
fn decode(bytes: &[u8], meshes: usize) -> Option<Vec<Vec<ConvexPiece>>> {
    let (body, hash) = bytes.split_at_checked(bytes.len().checked_sub(64)?)?;
    if sha256_hex(body).as_bytes() != hash {
        return None;
    }
    let mut words = body.chunks_exact(4).map(|c| [c[0], c[1], c[2], c[3]]);
    let mut out = Vec::new();
    for _ in 0..meshes {
        let mut pieces = Vec::new();
        for _ in 0..u32::from_le_bytes(words.next()?) {
            let corners = u32::from_le_bytes(words.next()?);
            let mut number = || words.next().map(f32::from_le_bytes);
            let points = (0..corners).map(|_| Some(Point3::new(number()?, number()?, number()?)));
            pieces.push(ConvexPiece { points: points.collect::<Option<_>>()? });
        }
        out.push(pieces);
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_survive_and_damage_is_noticed() {
        let cuboid = ConvexPiece::cuboid(Point3::new(0.0, 0.1, 0.2), Point3::new(1.0, 2.0, 3.0));
        let pieces = vec![vec![cuboid.clone(), cuboid], vec![]];
        let bytes = encode(&pieces);
        assert_eq!(decode(&bytes, 2), Some(pieces));
        for position in [0, 9, bytes.len() / 2, bytes.len() - 1] {
            let mut damaged = bytes.clone();
            damaged[position] ^= 1;
            assert_eq!(decode(&damaged, 2), None);
        }
        assert_eq!(decode(&bytes[..bytes.len() - 5], 2), None);
        assert_eq!(decode(&[], 2), None);
    }
}
