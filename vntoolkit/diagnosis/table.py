"""Every finding in words: what a check says when it finds something.

A name is the check's, which `--allow` takes, and a case of it after a slash. Of each: level, problem, what
was measured, what sound footage has, and the remedy; {names} stand for values that the check gives. This file
imports nothing: the site reads it.
"""

NOTE, WARNING, FATAL = "note", "warning", "fatal"

TABLE: dict[str, tuple[str, str, str, str, str]] = {
    "backdrop": (
        WARNING,
        "a backdrop, or a shadow at the border, counts as subject, with {share:.0%} of the normals",
        "an expected error of {region_deg:.0f} degrees there, {subject_deg:.0f} on the subject, medians",
        "below 20 all over",
        "give --mask; {mask} in the result's folder is a proposal, look at it first",
    ),
    "background/light": (
        WARNING,
        "the light of {whose} is not that of {of}: another session, sensor or gel",
        "{off:.0%} apart, {off_deg:.1f} degrees on the steepest slopes",
        "less than the calibration's residual, {residual_deg:.1f} degrees",
        "take the background in the session of the touches, and the rig of this sensor and light",
    ),
    "background/press": (
        FATAL,
        "the background holds a dent, at u {u:.0f} v {v:.0f}: it is no picture of the untouched gel",
        "{measured}",
        "no dent in common, and the gel at rest or pushed in",
        "take the background while nothing touches the gel",
    ),
    "bits": (
        NOTE,
        "8 bits per channel cost about 0.3 degrees",
        "8 bits",
        "10 or more",
        "record 10 or more bits where you can",
    ),
    "black": (
        WARNING,
        "{frames_show} no subject",
        "{empty} of {count} frames that are black or show far less than the others",
        "none",
        "they are kept as empty, and no other frame changes; --frames leaves them out",
    ),
    "black/all": (
        FATAL,
        "{frames_show} no subject",
        "{empty} of {count} frames that are black",
        "none",
        "are the lamps on, the lens open and the mask on the subject?",
    ),
    "black-level": (
        WARNING,
        "light that is none of the lamps' lies on the whole picture, the subject too",
        "{measured}",
        "0 times",
        "darken the room and shade the lens, or film once with the lamps off and give that picture with "
        "--background",
    ),
    "black-level/limited": (
        WARNING,
        "the footage looks of limited range, read as full",
        "{measured}",
        "0 times",
        "convert it with ffmpeg -vf scale=in_range=limited:out_range=full",
    ),
    "black-level/full": (
        WARNING,
        "the footage looks of full range, read as limited",
        "{measured}",
        "0 times",
        "mark the file as of full range (ffmpeg -c copy -color_range pc, or a re-encoding with "
        "scale=in_range=full)",
    ),
    "blur": (
        WARNING,
        "the picture is blurred: fine relief is lost, normals are too smooth",
        "a blur of {blur_px:.1f} pixels (standard deviation) at {edges} places of the outline",
        "less than 1.5",
        "focus on the subject and close the lens; where it moves, expose shorter",
    ),
    "camera": (
        FATAL,
        "the camera is hardly one that a lens makes: {problem}",
        "{measured}",
        "{expected}",
        "check K and distortion in rig.json: is this the camera of this picture, uncropped?",
    ),
    "chroma": (
        WARNING,
        "chroma subsampling {chroma} costs nothing on smooth surfaces, and up to {cost_deg} degrees on "
        "relief as fine as two pixels, such as a knit; `reconstruct` takes part of it back, `live` does "
        "not",
        "chroma {chroma}",
        "RGB or 4:4:4",
        "for such relief record RGB, raw or 4:4:4, or halve the picture size",
    ),
    "clipping": (
        WARNING,
        "{share:.1%} of the pixels are clipped: no normal there",
        "{share:.1%}",
        "less than 0.1%",
        "lower the exposure and film again",
    ),
    "clipping/plateau": (
        WARNING,
        "{share:.1%} of the pixels are clipped below full scale: the {channel} channel ends at {top:.0%}, "
        "as in a video of limited range or of a camera whose white is lower",
        "{times:.0f} times as many pixels there as just below",
        "fewer than below",
        "lower the exposure and film again",
    ),
    "codec": (
        WARNING,
        "{codec} is a lossy codec at most settings: its blocks show up as relief",
        "codec {codec}",
        "a lossless one",
        "record losslessly, or with the highest bit rate",
    ),
    "condition": (
        WARNING,
        "M multiplies noise",
        "a condition number of {condition:.0f}",
        "less than 10",
        "move the lamps further apart or make their colours purer, and calibrate again",
    ),
    "cone": (
        WARNING,
        "the rig was fitted on normals within {cone_deg:.0f} degrees of their mean: steeper are a guess",
        "a cone of {cone_deg:.0f} degrees",
        "20 or more",
        "calibrate again with the target tilted by 20 degrees and more",
    ),
    "cone/contacts": (
        WARNING,
        "the contacts are narrow for this ball, so they show no steep slopes",
        "contact radius {share:.2f} of the ball's, {slope_deg:.0f} degrees",
        "0.45 or more",
        "press deeper; or was the ball's diameter given as --ball-radius-mm?",
    ),
    "contacts": (
        WARNING,
        "the contacts are no circles: a pixel is not as high as wide, so that areas and depths are off",
        "contacts {aspect:.3f} ± {error:.3f} times as high as wide, median",
        "1",
        "scale the frames to square pixels, or give --corners and --size-mm, which take a size each way",
    ),
    "corners": (
        FATAL,
        "most of the picture is darker than the gel where it is pressed: a dark frame around it",
        "a median of {share:.2f} times the gel's colour",
        "0.5 or more",
        "give --corners and --size-mm, the gel's corners in the picture and the size between them",
    ),
    "cut-off": (
        FATAL,
        "the video is cut off: it declares {promised} frames, {came} came",
        "{came} frames",
        "{promised}",
        "copy the file again, or use what came with --frames 0:{came}",
    ),
    "dim": (
        NOTE,
        "the picture uses {brightest:.0%} of the range",
        "{brightest:.0%}",
        "more than 25%",
        "open the lens: more light means less noise",
    ),
    "drift": (
        WARNING,
        "the camera's {what} drifts from frame {first} to {last}: what does not move changes",
        "{red:+.0f} % red, {green:+.0f} % green, {blue:+.0f} % blue",
        "less than 2%",
        "lock exposure and white balance, and film again",
    ),
    "drift/subject": (
        WARNING,
        "the white balance or a lamp changes from frame {first} to {last}: the subject's colours do, "
        "whatever its pose",
        "{red} red, {blue} blue against green",
        "less than 2%",
        "lock exposure and white balance, let the lamps warm up, and film again",
    ),
    "flat": (
        WARNING,
        "the subject is flat: nothing but noise changes its normals",
        "a spread of {spread_deg:.1f} degrees",
        "more than 2.5",
        "is this the backdrop or a wall? give --mask, or film the subject",
    ),
    "flicker": (
        WARNING,
        "the light flickers: the subject's brightness goes up and down from frame to frame",
        "{change:.1%} ± {error:.1%} against the mean of the frames before and after",
        "less than 2%",
        "film with a shutter time of a multiple of 1/100 s (mains of 50 Hz) or 1/120 s (60 Hz), or feed "
        "the lamps with direct current",
    ),
    "flicker/bands": (
        WARNING,
        "the light flickers while the shutter rolls: bands run over the picture from frame to frame, and "
        "turn normals where the lamps do not flicker alike",
        "{rows:.1%} from row to row, {columns:.1%} from column to column",
        "less than 1.2%",
        "film with a shutter time of a multiple of 1/100 s (mains of 50 Hz) or 1/120 s (60 Hz), or feed "
        "the lamps with direct current",
    ),
    "gaps": (
        FATAL,
        "{missing} of {count} files of the sequence are missing: {names}",
        "{present} files",
        "{count}",
        "copy them too, or leave these frames out with --gaps skip",
    ),
    "gloss": (
        WARNING,
        "the surface is glossy: highlights pull normals towards the lamps, one in twenty by {turn_deg:.0f}"
        " degrees and more",
        "highlights of {strength:.0%} ± {error:.1%} of the matte light",
        "less than 3%",
        "powder the surface, or put crossed polarising filters before lamps and camera",
    ),
    "grey": (
        FATAL,
        "the footage is grey",
        "one channel",
        "three",
        "three coloured lights need a colour camera",
    ),
    "jump": (
        WARNING,
        "tracking lost most of the surface in {low} of {count} frames, most in {worst}, at once between "
        "frames {first} and {second}",
        "{share:.0%} of the vertices reported visible",
        "50% and more",
        "the surface jumps there: film at a higher frame rate, or track the parts before and after by "
        "themselves",
    ),
    "labels/size": (
        FATAL,
        "the labels are of a picture of another size than the presses",
        "{wide:.2f} times the dents' distances in u, {high:.2f} in v",
        "1.00",
        "name the labels' picture with --label-size, about {width:.0f} {height:.0f}",
    ),
    "labels/beside": (
        FATAL,
        "the labels lie beside the dents",
        "{radii:.1f} contact radii, median",
        "less than 0.6",
        "are these the labels of these images, and of this rectification? Without --labels the contact "
        "circles are found",
    ),
    "labels/offset": (
        FATAL,
        "the labels lie beside the dents by as much as is allowed for, or more",
        "an offset of {offset_px:.1f} pixels",
        "less than {largest_px:.1f}",
        "label again, or leave --labels out: the contact circles are then found",
    ),
    "lamps": (
        FATAL,
        "{what} shines from behind a surface that faces the camera",
        "light of {red:.2f}, {green:.2f}, {blue:.2f} in red, green, blue on it",
        "more than 0 in each",
        "a lamp file has x right, y up, z towards the viewer; M has z forward and a row per channel: check"
        " the sign of z, and whether M is transposed",
    ),
    "lost": (
        WARNING,
        "tracking lost most of the surface in {low} of {count} frames, most in {worst}",
        "{share:.0%} of the vertices reported visible",
        "50% and more",
        "look at the checkerboard there, and give a template in the middle of the sequence (--template)",
    ),
    "mask": (
        FATAL,
        "the mask covers the dark and leaves out what is lit",
        "{within:.0%} lit inside the mask, {without:.0%} outside",
        "30% or more inside",
        "the mask is inverted or of other footage: white is the subject; invert it",
    ),
    "near-lamps": (
        NOTE,
        "the lamps stand near, so that M changes over the picture; the rig's is one for all of it",
        "a distance of {distance:.1f} times the picture's larger side, {least:.1f} to {most:.1f}",
        "more than 12 times",
        "`reconstruct` corrects M by what is established; calibrate with --degree 2 for the rest, or move "
        "the lamps away",
    ),
    "noise": (
        FATAL,
        "the footage shows noise, no surface",
        "a correlation of {coherence:.2f} between normals 4 pixels apart",
        "0.5 to 1",
        "are the lamps on, the lens cap off and the mask on the subject?",
    ),
    "outline": (
        FATAL,
        "the normals turn inwards along the subject's outline, as if it were hollow",
        "a mean outward part of {outward:.2f} ± {error:.2f}",
        "0 to 1",
        "x and y of M both look reversed (lamps turned by 180 degrees): give lamps and normals with x "
        "right, y down, z forward in rig.json, or calibrate again",
    ),
    "matrix": (
        WARNING,
        "the normals make no surface; the rig fits better {best}",
        "{measured}",
        "0.5 to 1",
        "{fits}",
    ),
    "matrix/away": (
        FATAL,
        "the rig's normals face away from the camera",
        "{share:.0%} of the lit pixels",
        "less than 10 %",
        "this rig is not of this footage: calibrate again with these lamps and this camera",
    ),
    "matrix/channels": (
        FATAL,
        "{whose} fits {of} with exchanged channels",
        "{came} in place of red, green, blue",
        "red, green, blue",
        "read it as RGB; OpenCV gives BGR: frame[..., ::-1]",
    ),
    "matrix/paint": (
        WARNING,
        "paint hides the surface: M was checked as if all of it were of one paint; white balance, gloss "
        "and black level, which lengths tell, were not checked; a rig of one material gives wrong normals "
        "beside paint",
        "an agreement of mixed derivatives of {before:.2f} as of one material, {after:.2f} with paint "
        "levelled",
        "0.5 to 1",
        "calibrate with one photograph per lamp (--single-light), so that paints are told apart",
    ),
    "matrix/paint-told-apart": (
        NOTE,
        "paint hides the surface: M was checked as if all of it were of one paint; white balance, gloss "
        "and black level, which lengths tell, were not checked",
        "an agreement of mixed derivatives of {before:.2f} as of one material, {after:.2f} with paint "
        "levelled",
        "0.5 to 1",
        "check them on a subject of one colour",
    ),
    "matrix/unchecked": (
        NOTE,
        "M's axes, the order of the channels, the lamps' places and the curve could not be checked: the "
        "normals tell too little of a surface",
        "{painted:.0%} of the subject beside steps of paint, and an agreement of mixed derivatives of "
        "{own:.2f} ± {error:.2f}, {mirrored:.2f} if mirrored",
        "0.5 to 1",
        "check the rig on a subject of one colour, or look whether the normals are convex where the "
        "subject is",
    ),
    "matrix/unchecked-paint": (
        WARNING,
        "M's axes, the order of the channels, the lamps' places and the curve could not be checked: the "
        "normals tell too little of a surface; a rig of one material gives wrong normals beside paint",
        "{painted:.0%} of the subject beside steps of paint, and an agreement of mixed derivatives of "
        "{own:.2f} ± {error:.2f}, {mirrored:.2f} if mirrored",
        "0.5 to 1",
        "calibrate with one photograph per lamp (--single-light), so that paints are told apart, and check"
        " this rig on a subject of one colour",
    ),
    "residual": (
        WARNING,
        "the calibration contradicts its own samples",
        "a median residual of {residual_deg:.0f} degrees",
        "less than 8",
        "was this the calibration object, matte, of one colour, alone in the mask?",
    ),
    "sharpening": (
        WARNING,
        "the picture was sharpened: noise and fine relief are steeper than the surface",
        "{overshoot:.1%} of a step too bright beside it, at {edges} places",
        "less than 3%",
        "switch sharpening off in the camera, or in the program that converted its files",
    ),
    "sharpening/halo": (
        WARNING,
        "the picture was sharpened: noise and fine relief are steeper than the surface",
        "a background {darker:.0%} darker beside the outline than six pixels away, at {edges} places",
        "no darker",
        "switch sharpening off in the camera, or in the program that converted its files",
    ),
    "size": (
        FATAL,
        "the frames are {width}×{height}, the rig's camera is {camera}",
        "{width}×{height}",
        "{camera}",
        "calibrate with footage of this size",
    ),
    "steps": (
        WARNING,
        "the {channel} lamp, or its channel's white balance, changes at once: {changes}",
        "{measured}",
        "1 within 2%",
        "normals are wrong there; film again with steady lamps and locked white balance, or reconstruct "
        "the other frames alone (--frames)",
    ),
    "steps/mirrored": (
        WARNING,
        "the picture is mirrored from frame {number} on ({how})",
        "frame {number} is like the one before it only if it is mirrored",
        "one way round throughout",
        "normals are wrong there: mirror these frames back, or leave them out (--frames)",
    ),
    "steps/lag": (
        WARNING,
        "the {late} channel was filmed a frame after the {early} one",
        "the changes of a frame before leave {share:.0%} of what those of the same frame leave",
        "all three at once",
        "move the channel by a frame, or film with lamps that are on together",
    ),
    "stray": (
        WARNING,
        "left out, since the frames are named otherwise: {names}",
        "{count} files",
        "none",
        "keep masks and thumbnails in another folder",
    ),
    "tag": (
        WARNING,
        "the file states the transfer curve {stated} but is read as {used}",
        "{stated}",
        "{used}",
        "leave --transfer out, unless the tag is known to be wrong",
    ),
    "tag/rig": (
        FATAL,
        "the file states the transfer curve {stated}, the rig's is {used}",
        "{stated}",
        "{used}",
        "film as the rig was calibrated, or calibrate as it was filmed",
    ),
    "times": (
        WARNING,
        "{why}; the frames are played at {rate_hz:g} per second",
        "times that do not tell when a frame was filmed",
        "times that rise",
        "give --frame-rate-hz with the rate that they were filmed at",
    ),
    "transfer": (
        WARNING,
        "the transfer curve looks like {curve}, not {stated}: the brightness of one material changes with "
        "its direction as between these two",
        "a slope of {slope:.2f} ± {error:.2f}",
        "0",
        "give --transfer {curve} if the rig was calibrated so, else calibrate again; a subject of several "
        "colours looks so too: calibrate it with one photograph per lamp (--single-light)",
    ),
    "transfer/calibrated": (
        WARNING,
        "the footage is read with another curve than the rig was calibrated with",
        "{given}",
        "{calibrated}",
        "leave --transfer out, so that the rig's curve is used, or calibrate with this curve",
    ),
    "transfer/codec": (
        NOTE,
        "{codec} files of cameras and telephones are rarely linear",
        "linear",
        "bt709 (video) or srgb (JPEG)",
        "if this one is not linear, give --transfer bt709 or srgb",
    ),
    "transfer/presses": (
        WARNING,
        "the presses fit better with the transfer curve {curve} than with {used}",
        "{angle_deg:.1f} degrees left by one M",
        "{least_deg:.1f}, as with {curve}",
        "calibrate with --transfer {curve}; tactile sensors mostly store raw values",
    ),
    "transfer/samples": (
        FATAL,
        "the transfer curve looks like {curve}, not {stated}: one M explains the calibration object better",
        "a residual of {residual_deg:.1f} degrees",
        "{least_deg:.1f}, as under {curve}",
        "give --transfer {curve} (or bt709 for video)",
    ),
    "white-balance": (
        WARNING,
        "the white balance looks changed since calibration, or the subject has another colour: normals "
        "turn by {turn_deg:.0f} degrees in the median",
        "red by {red:+.0f} % and blue by {blue:+.0f} % against green, which leaves {left:.0%} of the "
        "spread of lengths",
        "0 %",
        "lock it, and film or calibrate again; on a subject of another colour, calibrate on that colour",
    ),
    "zoom": (
        WARNING,
        "the footage looks filmed at another zoom than the rig was calibrated at ({because})",
        "{zoom:.2f} times its focal length",
        "1 within 15%",
        "film at the zoom of the calibration, or calibrate again at this one",
    ),
}

CHECK_NAMES = frozenset(name.partition("/")[0] for name in TABLE)
