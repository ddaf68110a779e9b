;; Grasping an obstructed object: the action model of Lee & Kim 2019, Fig. 4.
;;
;; A planner cannot compute with poses and paths. Symbols stand for them instead ("some grasp pose of object_36"), the
;; plan is made as if they all existed, and motion planning afterwards binds each symbol to a value or refutes it.
;;
;; Mended with respect to the figure; each mark [n] below is explained here:
;; [1] Both put-downs leave the gripper empty. In the figure nothing ever empties it again, so that no obstacle can be
;;     cleared and the target still be grasped: taken literally, the domain has no plan for an obstructed target.
;; [2] PickUp takes the object away from where it stood. In the figure it stays there while it is held.
;; [3] PickUp has the object's location among its parameters. In the figure it is used without being declared.
;; [4] Base and arm have poses and trajectories of their own types. With one isMotion for both, MoveBase could drive
;;     the base to a grasp pose of the arm. A base trajectory names where it leads, not where it starts: from anywhere.
;; [5] A location is taken by what stands on it. In the figure only the one triple isClearanceLocation(location,
;;     obstacle, target) is used up, so that the same location can be given to an obstacle again for another target.
;; [6] PutDownGeneral asks that the held object be no obstacle; the figure names an undeclared `obs` there.
;; [7] PickUp asks that every gripper be empty. In the figure only its own: with two, the shortest plan then hides an
;;     obstacle in the other hand and never puts it down. The option hold_aside restores the figure's precondition.
;; [8] A gripper takes an object through grasp poses of its own arm.
;; [9] Where objects are to be put at places of a goal, the order that motion planning has found is a fact.
;; [10] So is the order of two put-downs, where one gripper keeps an object while another one moves others.
(define (domain obstructed-grasp)
  (:requirements :strips :typing :negative-preconditions :universal-preconditions :conditional-effects)
  (:types
    obj gripper pose traj loc - object
    base-pose arm-pose - pose      ; [4]
    base-traj arm-traj - traj)
  (:predicates
    (empty ?g - gripper)
    (robotAt ?p - base-pose)
    (objectAt ?o - obj ?l - loc)
    (occupied ?l - loc)            ; [5]
    (graspedBy ?o - obj ?g - gripper)
    ;; Poses and paths assumed to exist until motion planning says otherwise.
    (isGrasp ?p - arm-pose ?o - obj ?l - loc)
    (outOfReach ?g - gripper ?p - arm-pose) ; [8]
    (isPlacementLocation ?l - loc ?o - obj)
    (isClearanceLocation ?l - loc ?obs - obj ?tar - obj)
    (isMotion ?t - arm-traj ?from - base-pose ?to - arm-pose)
    (isBaseMotion ?t - base-traj ?to - base-pose)
    ;; Known from motion planning alone.
    (obstructs ?blocker - obj ?t - arm-traj ?blocked - obj)
    (obstacle ?o - obj)
    (waitsFor ?o - obj ?first - obj) ; [9]
    (putAfter ?o - obj ?first - obj)) ; [10]

  ;; From the base pose ?pose1 the arm follows ?traj to the grasp pose ?pose2; no object may stand in its way.
  (:action PickUp
    :parameters (?obj - obj ?gripper - gripper ?pose1 - base-pose ?pose2 - arm-pose ?traj - arm-traj ?objLoc - loc) ; [3]
    :precondition (and
      (forall (?any - gripper) (empty ?any)) ; [7]
      (robotAt ?pose1)
      (objectAt ?obj ?objLoc)
      (isGrasp ?pose2 ?obj ?objLoc)
      (not (outOfReach ?gripper ?pose2)) ; [8]
      (isMotion ?traj ?pose1 ?pose2)
      (forall (?other - obj) (not (obstructs ?other ?traj ?obj)))
      (forall (?first - obj) (not (waitsFor ?obj ?first)))) ; [9]
    :effect (and
      (graspedBy ?obj ?gripper)
      (not (empty ?gripper))
      (not (objectAt ?obj ?objLoc))  ; [2]
      (not (occupied ?objLoc))
      (forall (?other - obj ?blocked - arm-traj) (not (obstructs ?obj ?blocked ?other)))))

  ;; Put down an object that is in nobody's way.
  (:action PutDownGeneral
    :parameters (?obj - obj ?gripper - gripper ?pose1 - base-pose ?pose2 - arm-pose ?traj - arm-traj ?targetLoc - loc)
    :precondition (and
      (graspedBy ?obj ?gripper)
      (robotAt ?pose1)
      (not (obstacle ?obj))          ; [6]
      (isPlacementLocation ?targetLoc ?obj)
      (not (occupied ?targetLoc))    ; [5]
      (isGrasp ?pose2 ?obj ?targetLoc)
      (isMotion ?traj ?pose1 ?pose2)
      (forall (?other - obj) (not (obstructs ?other ?traj ?obj)))
      (forall (?first - obj) (not (putAfter ?obj ?first)))) ; [10]
    :effect (and
      (not (graspedBy ?obj ?gripper))
      (empty ?gripper)               ; [1]
      (objectAt ?obj ?targetLoc)
      (occupied ?targetLoc)
      (forall (?next - obj) (not (waitsFor ?next ?obj))) ; [9]
      (forall (?next - obj) (not (putAfter ?next ?obj))))) ; [10]

  ;; Put down an obstacle where it no longer obstructs ?tar; naming ?tar is what makes it a clearance.
  (:action PutDownForClearance
    :parameters (?obs - obj ?tar - obj ?gripper - gripper ?pose1 - base-pose ?pose2 - arm-pose ?traj - arm-traj
                 ?targetLoc - loc)
    :precondition (and
      (graspedBy ?obs ?gripper)
      (robotAt ?pose1)
      (obstacle ?obs)
      (isClearanceLocation ?targetLoc ?obs ?tar)
      (not (occupied ?targetLoc))    ; [5]
      (isGrasp ?pose2 ?obs ?targetLoc)
      (isMotion ?traj ?pose1 ?pose2)
      (forall (?other - obj) (not (obstructs ?other ?traj ?obs)))
      (forall (?first - obj) (not (putAfter ?obs ?first)))) ; [10]
    :effect (and
      (not (graspedBy ?obs ?gripper))
      (empty ?gripper)               ; [1]
      (objectAt ?obs ?targetLoc)
      (occupied ?targetLoc)
      (forall (?next - obj) (not (waitsFor ?next ?obs))) ; [9]
      (forall (?next - obj) (not (putAfter ?next ?obs))) ; [10]
      (not (obstacle ?obs))
      (not (isClearanceLocation ?targetLoc ?obs ?tar))))

  (:action MoveBase
    :parameters (?pose1 - base-pose ?pose2 - base-pose ?traj - base-traj)
    :precondition (and (robotAt ?pose1) (isBaseMotion ?traj ?pose2))
    :effect (and (not (robotAt ?pose1)) (robotAt ?pose2))))
